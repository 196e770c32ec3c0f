/* The player: state, controls, keys. All text from files goes in as text, never as HTML. */

const KIND_NAMES = { science: "science", standard: "standard star", sky: "sky", guide: "guide star" };
const PATH_NAMES = { start_to_target: "start → target", start_to_park: "start → park", park_to_target: "park → target" };
const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8, 16];
const SEPARATION_TOLERANCE_MM = 1e-5; // positions in the page are rounded to 1e-6 mm

class Player {
  constructor(data) {
    this.data = data;
    this.time = 0; this.playing = false; this.speed = 1; this.visit = 0; this.path = data.paths[0]; this.selected = -1;
    this.look = {
      theme: "light", palette: "paper", sort: "robot", strip: "when", duration: 1,
      patrol: true, targets: true, park: true, zone: true, ways: false, ids: false, eastLeft: false,
    };
    this.$ = (id) => document.getElementById(id);
    this.routes = new Map();
    this.makePanes();
    this.makePickers();
    this.makeControls();
    this.watchTheme();
    this.readAddress();
    this.load();
    requestAnimationFrame((now) => this.tick(now));
  }

  /* What the address asks for: view.html#visit=1&path=start_to_park */
  readAddress() {
    const asked = new URLSearchParams(window.location.hash.slice(1));
    const visit = this.data.runs[0].visits.findIndex((one) => String(one.id) === asked.get("visit"));
    if (visit >= 0) this.visit = visit;
    if (this.data.paths.includes(asked.get("path"))) this.path = asked.get("path");
  }

  /* One pane a run: the plate, and its line of figures. */
  makePanes() {
    this.panes = this.data.runs.map((run) => {
      const pane = this.$("pane").content.firstElementChild.cloneNode(true);
      pane.querySelector("h2").textContent = run.name;
      this.$("panes").append(pane);
      const view = new PlateView(pane.querySelector(".plate"), this.look);
      const strip = new TimeStrip(pane.querySelector(".strip"), this.look);
      const figures = Object.fromEntries([...pane.querySelectorAll("[data-figure]")].map((item) => [item.dataset.figure, item]));
      this.watchPointer(view);
      this.watchStrip(strip);
      return { run, pane, view, strip, figures };
    });
    document.body.classList.toggle("compare", this.panes.length > 1);
    new ResizeObserver(() => this.redraw()).observe(this.$("panes"));
  }

  makePickers() {
    const visits = this.$("visit");
    this.data.runs[0].visits.forEach((visit, i) => visits.append(new Option(visit.label, i)));
    visits.onchange = () => this.setVisit(+visits.value);
    this.$("previous").onclick = () => this.setVisit(this.visit - 1);
    this.$("next").onclick = () => this.setVisit(this.visit + 1);
    for (const path of this.data.paths) {
      const label = document.createElement("label"), radio = document.createElement("input");
      Object.assign(radio, { type: "radio", name: "path", value: path, checked: path === this.path });
      radio.onchange = () => this.setPath(path);
      const word = document.createElement("span");
      word.textContent = PATH_NAMES[path];
      label.append(radio, word); this.$("path").append(label);
    }
    SPEEDS.forEach((speed) => this.$("speed").append(new Option(`${speed} ×`, speed, speed === 1, speed === 1)));
    this.$("speed").onchange = () => { this.speed = +this.$("speed").value; };
  }

  makeControls() {
    this.$("play").onclick = () => this.toggle();
    this.$("begin").onclick = () => this.seek(0);
    this.$("end").onclick = () => this.seek(this.duration);
    this.$("back").onclick = () => this.stepTick(-1);
    this.$("forward").onclick = () => this.stepTick(1);
    this.$("scrub").oninput = () => this.seek((+this.$("scrub").value / 1000) * this.duration, true);
    for (const box of document.querySelectorAll("[data-layer]")) {
      box.checked = this.look[box.dataset.layer];
      box.onchange = () => { this.look[box.dataset.layer] = box.checked; this.redraw(); };
    }
    for (const choice of document.querySelectorAll("[data-look]")) {
      choice.onchange = () => { this.look[choice.dataset.look] = choice.value; this.showLegend(); this.loadStrip(); this.redraw(); };
    }
    this.$("find").onchange = () => {
      const index = this.plate.robot_id.indexOf(+this.$("find").value);
      this.select(index);
      this.$("find").setCustomValidity(index < 0 && this.$("find").value ? "no such robot" : "");
      this.$("find").reportValidity();
    };
    this.$("help-open").onclick = () => this.$("help").showModal();
    this.$("help-close").onclick = () => this.$("help").close();
    document.addEventListener("keydown", (event) => this.onKey(event));
  }

  onKey(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || this.$("help").open) return;
    if (["SELECT", "INPUT"].includes(event.target.tagName) && !["checkbox", "radio", "range"].includes(event.target.type)) return;
    if (event.target.type === "radio" && event.key.startsWith("Arrow")) return;
    const isButton = event.target.tagName === "BUTTON" || event.target.type === "checkbox";
    const keys = {
      " ": () => this.toggle(), k: () => this.toggle(),
      ArrowRight: () => this.stepTick(1), ArrowLeft: () => this.stepTick(-1),
      ".": () => this.seek(this.time + 0.1), ",": () => this.seek(this.time - 0.1),
      Home: () => this.seek(0), End: () => this.seek(this.duration),
      n: () => this.setVisit(this.visit + 1), p: () => this.setVisit(this.visit - 1),
      "+": () => this.shiftSpeed(1), "=": () => this.shiftSpeed(1), "-": () => this.shiftSpeed(-1),
      Escape: () => this.select(-1), r: () => { this.panes.forEach(({ view }) => view.resetView()); this.redraw(); },
      "?": () => this.$("help").showModal(),
    };
    this.data.paths.forEach((path, i) => { keys[i + 1] = () => this.setPath(path); });
    const act = keys[event.key];
    if (!act || (isButton && event.key === " ")) return;
    event.preventDefault();
    act();
  }

  watchPointer(view) {
    const canvas = view.canvas;
    let from = null;
    canvas.addEventListener("pointerdown", (event) => { from = { x: event.clientX, y: event.clientY, moved: false }; canvas.setPointerCapture(event.pointerId); });
    canvas.addEventListener("pointermove", (event) => {
      if (!from) { canvas.style.cursor = view.route && view.hit(event.clientX, event.clientY) >= 0 ? "pointer" : "grab"; return; }
      const dx = event.clientX - from.x, dy = event.clientY - from.y;
      if (!from.moved && Math.hypot(dx, dy) < 4) return;
      from.moved = true;
      for (const pane of this.panes) pane.view.pan(dx, dy);
      from.x = event.clientX; from.y = event.clientY;
      this.redraw();
    });
    canvas.addEventListener("pointerup", (event) => {
      if (from && !from.moved) this.select(view.hit(event.clientX, event.clientY));
      from = null;
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const factor = Math.exp(-event.deltaY * 0.0015), box = canvas.getBoundingClientRect();
      for (const pane of this.panes) {
        const other = pane.view.canvas.getBoundingClientRect();
        pane.view.zoomAt(event.clientX - box.left + other.left, event.clientY - box.top + other.top, factor);
      }
      this.redraw();
    }, { passive: false });
    canvas.addEventListener("dblclick", () => { this.panes.forEach((pane) => pane.view.resetView()); this.redraw(); });
  }

  watchStrip(strip) {
    const canvas = strip.canvas;
    let isDown = false;
    const act = (event) => { if (this.look.strip === "when") this.seek(strip.timeAt(event.clientX), true); };
    canvas.addEventListener("pointerdown", (event) => {
      isDown = true; canvas.setPointerCapture(event.pointerId); act(event);
      const robot = strip.robotAt(event.clientX, event.clientY);
      if (robot >= 0) this.select(robot);
    });
    canvas.addEventListener("pointermove", (event) => { if (isDown) act(event); });
    canvas.addEventListener("pointerup", () => { isDown = false; });
  }

  watchTheme() {
    const dark = window.matchMedia("(prefers-color-scheme: dark)");
    const apply = () => { this.look.theme = dark.matches ? "dark" : "light"; this.showLegend(); this.redraw(); };
    dark.addEventListener("change", apply);
    apply();
  }

  get plate() { return this.data.plates[this.visitData(0).plate]; }

  visitData(run) {
    const visits = this.data.runs[run].visits, visit = visits[Math.min(this.visit, visits.length - 1)];
    visit.targets = this.data.runs[run].targets;
    visit.reason = (robot) => (visit.reasons[this.path] || {})[robot] || "";
    return visit;
  }

  route(run) {
    const key = `${run}/${this.visit}/${this.path}`;
    if (!this.routes.has(key)) {
      const visit = this.visitData(run), plate = this.data.plates[visit.plate];
      this.routes.set(key, new Route(plate.instrument, visit.begin[this.path], visit.legs[this.path]));
      if (this.routes.size > 24) this.routes.delete(this.routes.keys().next().value);
    }
    return this.routes.get(key);
  }

  setVisit(visit) {
    const last = this.data.runs[0].visits.length - 1;
    this.visit = Math.min(last, Math.max(0, visit));
    this.load();
  }

  setPath(path) {
    this.path = path;
    this.load();
  }

  load() {
    this.time = 0;
    for (const [run, pane] of this.panes.entries()) {
      pane.route = this.route(run);
      const visit = this.visitData(run);
      pane.view.show(this.data.plates[visit.plate], visit, pane.route, this.path !== "start_to_park");
    }
    this.duration = Math.max(...this.panes.map((pane) => pane.route.duration));
    this.look.duration = this.duration;
    this.$("visit").value = this.visit;
    this.$("previous").disabled = this.visit === 0;
    this.$("next").disabled = this.visit === this.data.runs[0].visits.length - 1;
    for (const radio of document.querySelectorAll("[name=path]")) radio.checked = radio.value === this.path;
    this.$("find").max = this.plate.robot_id.length;
    this.showTicks();
    this.loadStrip();
    this.select(Math.min(this.selected, this.plate.robot_id.length - 1));
    this.redraw();
  }

  loadStrip() {
    for (const pane of this.panes) pane.strip.show(pane.view.plate, pane.route);
  }

  showTicks() {
    this.$("marks").replaceChildren(...this.panes[0].route.ticks.map((start) => new Option("", (1000 * start) / Math.max(this.duration, 1e-9))));
  }

  toggle() {
    if (!this.playing && this.time >= this.duration) this.time = 0;
    this.playing = !this.playing && this.duration > 0;
    this.showPlaying();
    this.dirty = true;
  }

  showPlaying() {
    this.$("play").textContent = this.playing ? "❚❚" : "▶";
    this.$("play").setAttribute("aria-label", this.playing ? "pause" : "play");
  }

  seek(time, keepPlaying = false) {
    this.time = Math.min(this.duration, Math.max(0, time));
    if (!keepPlaying) { this.playing = false; this.showPlaying(); }
    this.dirty = true;
  }

  stepTick(direction) {
    const marks = [...new Set([...this.panes.flatMap((pane) => pane.route.ticks), this.duration])].sort((a, b) => a - b);
    const next = direction > 0 ? marks.find((t) => t > this.time + 1e-6) : marks.filter((t) => t < this.time - 1e-6).pop();
    this.seek(next === undefined ? (direction > 0 ? this.duration : 0) : next);
  }

  shiftSpeed(by) {
    const next = SPEEDS[Math.min(SPEEDS.length - 1, Math.max(0, SPEEDS.indexOf(this.speed) + by))];
    this.speed = next; this.$("speed").value = next;
  }

  select(robot) {
    this.selected = robot;
    this.$("find").value = robot < 0 ? "" : this.plate.robot_id[robot];
    this.showRobot();
    this.dirty = true;
  }

  /* What is known of the selected robot, in each run. */
  showRobot() {
    const panel = this.$("robot");
    panel.replaceChildren();
    this.$("robot-none").hidden = this.selected >= 0;
    if (this.selected < 0) return;
    const i = this.selected, plate = this.plate;
    const line = (term, text) => {
      const dt = document.createElement("dt"), dd = document.createElement("dd");
      dt.textContent = term; dd.textContent = text; panel.append(dt, dd);
    };
    line("robot", `${plate.robot_id[i]}, ${plate.guide[i] ? "guide" : "science"}, ${plate.live[i] ? "live" : "dead"}`);
    line("park", `${plate.park.x[i].toFixed(2)}, ${plate.park.y[i].toFixed(2)} mm; reach ${plate.patrol[i]} mm`);
    for (const [run, pane] of this.panes.entries()) this.showRobotOf(run, pane, i, line, panel);
  }

  showRobotOf(run, pane, i, line, panel) {
    const visit = this.visitData(run), route = pane.route, id = visit.target[i];
    if (this.panes.length > 1) line("in", pane.run.name);
    const k = id === null ? -1 : visit.targets.id.indexOf(id);
    const words = k < 0 ? [] : [KIND_NAMES[visit.targets.kind[k]], `priority ${visit.targets.priority[k]}`];
    if (k >= 0 && visit.targets.mag[k] !== null) words.push(`mag ${visit.targets.mag[k]}`);
    line("target", id === null ? "none (idle)" : [id, ...words].join(", "));
    if (visit.reason(i)) line("unrouted", visit.reason(i));
    const [rotating, moving, waiting] = route.times(i);
    line("arrives", route.pieces[i].length ? `${route.arrival[i].toFixed(2)} s` : "does not move");
    line("times", `rotating ${rotating.toFixed(2)}, moving ${moving.toFixed(2)}, waiting ${waiting.toFixed(2)} s`);
    const rows = route.legRows[i];
    if (!rows.length) return;
    const table = document.createElement("table"), legs = route.legs;
    const cells = (tag, texts) => {
      const tr = table.insertRow();
      for (const text of texts) { const cell = document.createElement(tag); cell.textContent = text; tr.append(cell); }
    };
    cells("th", ["leg", "start s", "turn °", "dx mm", "dy mm"]);
    rows.forEach((row, n) => cells("td", [n, legs.start[row].toFixed(2), legs.rotate[row].toFixed(1), legs.dx[row].toFixed(2), legs.dy[row].toFixed(2)]));
    panel.append(table);
  }

  showLegend() {
    const colours = PALETTES[this.look.palette][this.look.theme];
    document.querySelectorAll("[data-state]").forEach((item) => { item.style.background = colours[+item.dataset.state]; });
    document.querySelectorAll("[data-kind]").forEach((item) => { item.style.color = KIND_COLOURS[item.dataset.kind][this.look.theme]; });
  }

  redraw() {
    for (const { view, strip } of this.panes) { view.stale = true; strip.stale = true; }
    this.dirty = true;
  }

  tick(now) {
    const seconds = Math.min(0.1, (now - (this.last ?? now)) / 1000);
    this.last = now;
    if (this.playing) {
      this.time = Math.min(this.duration, this.time + seconds * this.speed);
      if (this.time >= this.duration) { this.playing = false; this.showPlaying(); }
      this.dirty = true;
    }
    if (this.dirty) { this.dirty = false; this.draw(); }
    requestAnimationFrame((next) => this.tick(next));
  }

  draw() {
    for (const { view, strip, route, figures } of this.panes) {
      const sample = route.at(this.time), limit = view.plate.instrument.min_separation_mm - SEPARATION_TOLERANCE_MM;
      const { distance, pair, near } = nearest(sample.x, sample.y, limit);
      view.draw(sample, near, this.selected);
      strip.draw(this.time, this.selected);
      this.showFigures(figures, view, route, sample, distance, pair, near);
    }
    this.$("clock").textContent = `${this.time.toFixed(2)} / ${this.duration.toFixed(2)} s`;
    const scrub = this.$("scrub"), value = this.duration ? (1000 * this.time) / this.duration : 0;
    if (document.activeElement !== scrub || this.playing) scrub.value = value;
    scrub.setAttribute("aria-valuetext", `${this.time.toFixed(1)} seconds`);
  }

  showFigures(figures, view, route, sample, distance, pair, near) {
    const counts = [0, 0, 0, 0];
    sample.state.forEach((state) => { counts[state] += 1; });
    STATE_NAMES.forEach((name, state) => { figures[name].textContent = counts[state]; });
    figures.tick.textContent = `${route.tickAt(this.time)} / ${route.ticks.length}`;
    const ids = pair[0] < 0 ? "" : ` (${view.plate.robot_id[pair[0]]}, ${view.plate.robot_id[pair[1]]})`;
    figures.least.textContent = Number.isFinite(distance) ? `${(Math.floor(distance * 1000 + 0.01) / 1000).toFixed(3)} mm${ids}` : "–";
    figures.least.classList.toggle("bad", near.length > 0);
    figures.done.textContent = `${route.duration.toFixed(2)} s`;
    figures.p95.textContent = `${route.restTime(0.95).toFixed(2)} s`;
  }
}

window.player = new Player(JSON.parse(document.getElementById("data").textContent));
