/* Drawing: the plate with its robots, and the strip of their times. */

const PALETTES = {
  paper: { light: ["#d62728", "#1f6fd6", "#2ca02c"], dark: ["#ff6b6b", "#5aa2ff", "#5ed16a"] },
  safe: { light: ["#d55e00", "#0072b2", "#c9a300"], dark: ["#ff8c42", "#56b4e9", "#f0e442"] },
};
const KIND_COLOURS = {
  science: { light: "#6b7fa8", dark: "#8fa5d1" },
  standard: { light: "#b0761c", dark: "#e0ac55" },
  sky: { light: "#3f9aa5", dark: "#63c4d0" },
  guide: { light: "#8a4fb0", dark: "#c08be0" },
};
const TURN = 2 * Math.PI;

function cssColour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

function sized(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  return { context: canvas.getContext("2d"), width, height, ratio };
}

class PlateView {
  constructor(canvas, look) {
    this.canvas = canvas;
    this.look = look;
    this.ground = document.createElement("canvas");
    this.resetView();
  }

  resetView() { this.zoom = 1; this.panX = 0; this.panY = 0; this.stale = true; }

  /* holds: whether the path leads to this visit's targets. */
  show(plate, visit, route, holds) {
    this.plate = plate; this.visit = visit; this.route = route; this.stale = true;
    this.held = holds ? visit.target : visit.target.map(() => null);
  }

  frame() {
    const { width, height } = sized(this.canvas);
    const radius = this.plate.instrument.plate_radius_mm;
    this.scale = (this.zoom * Math.min(width, height)) / (2.1 * radius);
    this.centreX = width / 2 + this.panX; this.centreY = height / 2 + this.panY;
    this.side = this.look.eastLeft ? -1 : 1;
  }

  toX(x) { return this.centreX + this.side * this.scale * x; }
  toY(y) { return this.centreY - this.scale * y; }

  /* Robot under a point of the page, or -1. */
  hit(clientX, clientY) {
    const box = this.canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
    const x = (clientX - box.left) * ratio, y = (clientY - box.top) * ratio;
    const { x: xs, y: ys } = this.route.sample;
    let best = -1, least = Math.max(this.scale * this.plate.instrument.min_separation_mm / 2, 10 * ratio);
    for (let i = 0; i < xs.length; i++) {
      const distance = Math.hypot(this.toX(xs[i]) - x, this.toY(ys[i]) - y);
      if (distance < least) { least = distance; best = i; }
    }
    return best;
  }

  zoomAt(clientX, clientY, factor) {
    const box = this.canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
    const zoom = Math.min(40, Math.max(1, this.zoom * factor)), by = zoom / this.zoom;
    const fromX = (clientX - box.left) * ratio - this.canvas.width / 2;
    const fromY = (clientY - box.top) * ratio - this.canvas.height / 2;
    this.panX = fromX - by * (fromX - this.panX); this.panY = fromY - by * (fromY - this.panY);
    this.zoom = zoom;
    if (zoom === 1) this.resetView();
    this.stale = true;
  }

  pan(dx, dy) {
    const ratio = window.devicePixelRatio || 1;
    this.panX += dx * ratio; this.panY += dy * ratio; this.stale = true;
  }

  draw(sample, near, selected) {
    this.frame();
    const { context, width, height } = sized(this.canvas);
    if (this.stale || this.ground.width !== width || this.ground.height !== height) this.drawGround(width, height);
    context.clearRect(0, 0, width, height);
    context.drawImage(this.ground, 0, 0);
    if (selected >= 0) this.drawSelected(context, selected);
    this.drawRobots(context, sample, near, selected);
  }

  drawGround(width, height) {
    this.ground.width = width; this.ground.height = height;
    this.stale = false;
    const context = this.ground.getContext("2d"), look = this.look, plate = this.plate;
    const disc = (x, y, r) => { context.beginPath(); context.arc(this.toX(x), this.toY(y), r * this.scale, 0, TURN); };
    disc(0, 0, plate.instrument.plate_radius_mm);
    context.fillStyle = cssColour("--plate"); context.fill();
    context.lineWidth = 1.5; context.strokeStyle = cssColour("--plate-edge"); context.stroke();
    context.save(); context.clip();
    if (look.patrol) {
      context.strokeStyle = cssColour("--faint"); context.lineWidth = 0.6;
      plate.park.x.forEach((x, i) => { disc(x, plate.park.y[i], plate.patrol[i]); context.stroke(); });
    }
    context.restore();
    if (look.targets) this.drawTargets(context);
    if (look.ways) this.drawWays(context);
    if (look.park) {
      context.strokeStyle = cssColour("--park"); context.lineWidth = 1;
      const arm = Math.max(2, 0.9 * this.scale);
      context.beginPath();
      plate.park.x.forEach((x, i) => {
        const px = this.toX(x), py = this.toY(plate.park.y[i]);
        context.moveTo(px - arm, py); context.lineTo(px + arm, py); context.moveTo(px, py - arm); context.lineTo(px, py + arm);
      });
      context.stroke();
    }
    this.drawCompass(context, width, height);
  }

  drawTargets(context) {
    const { targets } = this.visit, held = new Set(this.held);
    const size = Math.max(2, 0.85 * this.scale) * Math.min(1, 1.6 / Math.sqrt(this.zoom) + 0.4);
    targets.x.forEach((x, k) => {
      const kind = targets.kind[k], px = this.toX(x), py = this.toY(targets.y[k]);
      const isHeld = held.has(targets.id[k]);
      context.globalAlpha = isHeld ? 1 : kind === "science" ? 0.2 + 0.5 * ((targets.priority[k] - 1) / 8) : 0.4;
      context.fillStyle = context.strokeStyle = (KIND_COLOURS[kind] || KIND_COLOURS.science)[this.look.theme];
      context.lineWidth = 1.2;
      context.beginPath();
      if (kind === "standard") {
        context.moveTo(px, py - 1.5 * size); context.lineTo(px + 1.5 * size, py);
        context.lineTo(px, py + 1.5 * size); context.lineTo(px - 1.5 * size, py); context.closePath(); context.fill();
      } else if (kind === "guide") {
        context.rect(px - 1.2 * size, py - 1.2 * size, 2.4 * size, 2.4 * size); context.fill();
      } else if (kind === "sky") {
        context.arc(px, py, 1.1 * size, 0, TURN); context.stroke();
      } else {
        context.arc(px, py, size, 0, TURN); context.fill();
      }
    });
    context.globalAlpha = 1;
  }

  drawWays(context) {
    context.strokeStyle = cssColour("--way"); context.lineWidth = 1;
    context.beginPath();
    for (const own of this.route.pieces) this.trace(context, own);
    context.stroke();
  }

  trace(context, pieces) {
    if (!pieces.length) return;
    context.moveTo(this.toX(pieces[0].x0), this.toY(pieces[0].y0));
    for (const piece of pieces) context.lineTo(this.toX(piece.x1), this.toY(piece.y1));
  }

  drawCompass(context, width, height) {
    const ratio = window.devicePixelRatio || 1, arm = 26 * ratio;
    const x = 24 * ratio + (this.side < 0 ? arm : 0), y = height - 22 * ratio;
    context.strokeStyle = context.fillStyle = cssColour("--muted"); context.lineWidth = 1.2 * ratio;
    context.font = `${11 * ratio}px system-ui, sans-serif`; context.textAlign = "center"; context.textBaseline = "middle";
    context.beginPath(); context.moveTo(x, y - arm); context.lineTo(x, y); context.lineTo(x + this.side * arm, y); context.stroke();
    context.fillText("N", x, y - arm - 8 * ratio); context.fillText("E", x + this.side * (arm + 9 * ratio), y);
    const length = [100, 50, 20, 10, 5, 2, 1].find((mm) => mm * this.scale < width / 5) || 1;
    const right = width - 20 * ratio;
    context.beginPath(); context.moveTo(right - length * this.scale, y); context.lineTo(right, y); context.stroke();
    context.fillText(`${length} mm`, right - (length * this.scale) / 2, y - 9 * ratio);
  }

  drawSelected(context, robot) {
    const plate = this.plate;
    context.beginPath();
    context.arc(this.toX(plate.park.x[robot]), this.toY(plate.park.y[robot]), plate.patrol[robot] * this.scale, 0, TURN);
    context.fillStyle = cssColour("--reach"); context.fill();
    context.strokeStyle = cssColour("--accent"); context.lineWidth = 1; context.setLineDash([5, 4]); context.stroke();
    context.setLineDash([]);
    context.beginPath(); this.trace(context, this.route.pieces[robot]);
    context.lineWidth = 2; context.stroke();
  }

  drawRobots(context, sample, near, selected) {
    const look = this.look, plate = this.plate, instrument = plate.instrument;
    const body = (instrument.robot_diameter_mm / 2) * this.scale, zone = (instrument.min_separation_mm / 2) * this.scale;
    const colours = PALETTES[look.palette][look.theme], rest = cssColour("--rest"), idle = cssColour("--idle");
    const edge = cssColour("--edge"), bad = cssColour("--bad"), dead = cssColour("--dead"), text = cssColour("--text");
    const heading = cssColour("--heading");
    const isNear = new Set(near);
    if (look.zone) {
      context.strokeStyle = cssColour("--zone"); context.lineWidth = 0.8; context.beginPath();
      for (let i = 0; i < sample.x.length; i++) {
        const px = this.toX(sample.x[i]), py = this.toY(sample.y[i]);
        context.moveTo(px + zone, py); context.arc(px, py, zone, 0, TURN);
      }
      context.stroke();
    }
    for (let i = 0; i < sample.x.length; i++) {
      const px = this.toX(sample.x[i]), py = this.toY(sample.y[i]), isDead = !plate.live[i];
      context.beginPath(); context.arc(px, py, body, 0, TURN);
      const hasTarget = this.held[i] !== null;
      context.fillStyle = isDead ? dead : sample.state[i] < RESTING ? colours[sample.state[i]] : hasTarget ? rest : idle;
      context.globalAlpha = 0.9; context.fill(); context.globalAlpha = 1;
      context.lineWidth = plate.guide[i] ? 2.2 : 0.8;
      context.strokeStyle = plate.guide[i] ? KIND_COLOURS.guide[look.theme] : edge; context.stroke();
      context.beginPath();
      if (isDead) {
        const arm = 0.55 * body;
        context.moveTo(px - arm, py - arm); context.lineTo(px + arm, py + arm);
        context.moveTo(px + arm, py - arm); context.lineTo(px - arm, py + arm);
      } else {
        const angle = (sample.theta[i] * Math.PI) / 180;
        context.moveTo(px, py); context.lineTo(px + this.side * body * Math.cos(angle), py - body * Math.sin(angle));
      }
      context.strokeStyle = isDead ? text : heading; context.lineWidth = Math.max(1, 0.16 * body); context.stroke();
      if (isNear.has(i) || this.visit.reason(i)) {
        context.beginPath(); context.arc(px, py, zone + 2, 0, TURN);
        context.strokeStyle = bad; context.lineWidth = 2; context.setLineDash(isNear.has(i) ? [] : [3, 3]); context.stroke(); context.setLineDash([]);
      }
      if (look.ids && body > 5) {
        context.fillStyle = text; context.font = `${Math.max(8, 0.9 * body)}px system-ui, sans-serif`;
        context.textAlign = "center"; context.textBaseline = "middle"; context.fillText(plate.robot_id[i], px, py - zone - 0.6 * body);
      }
    }
    if (selected >= 0) {
      context.beginPath(); context.arc(this.toX(sample.x[selected]), this.toY(sample.y[selected]), zone + 4, 0, TURN);
      context.strokeStyle = cssColour("--accent"); context.lineWidth = 3; context.stroke();
    }
  }
}

/* The strip of Figure 16: what each robot does when, or the seconds that it turned, went and waited. */
class TimeStrip {
  constructor(canvas, look) { this.canvas = canvas; this.look = look; this.ground = document.createElement("canvas"); this.stale = true; }

  show(plate, route) {
    this.plate = plate; this.route = route; this.stale = true;
    this.order = [...Array(route.n).keys()];
    if (this.look.sort === "time") this.order.sort((a, b) => route.arrival[b] - route.arrival[a] || a - b);
    this.row = new Map(this.order.map((robot, row) => [robot, row]));
  }

  layout() {
    const { width, height, ratio } = sized(this.canvas);
    this.left = 46 * ratio; this.right = width - 12 * ratio; this.top = 8 * ratio; this.bottom = height - 20 * ratio;
    this.span = Math.max(this.look.duration, 1e-9);
    return { width, height, ratio };
  }

  timeAt(clientX) {
    const box = this.canvas.getBoundingClientRect(), x = (clientX - box.left) * (window.devicePixelRatio || 1);
    return Math.min(1, Math.max(0, (x - this.left) / (this.right - this.left))) * this.span;
  }

  robotAt(clientX, clientY) {
    const box = this.canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
    const along = this.look.strip === "when"
      ? ((clientY - box.top) * ratio - this.top) / (this.bottom - this.top)
      : ((clientX - box.left) * ratio - this.left) / (this.right - this.left);
    return along >= 0 && along < 1 ? this.order[Math.floor(along * this.order.length)] : -1;
  }

  draw(time, selected) {
    const { width, height, ratio } = this.layout();
    const isStale = this.stale || this.ground.width !== width || this.ground.height !== height;
    const x = Math.round(this.left + (time / this.span) * (this.right - this.left));
    if (!isStale && this.shown.x === x && this.shown.selected === selected) return; // nothing moved by a pixel
    this.shown = { x, selected };
    if (isStale) this.drawGround(width, height, ratio);
    const context = this.canvas.getContext("2d");
    context.clearRect(0, 0, width, height); context.drawImage(this.ground, 0, 0);
    context.strokeStyle = context.fillStyle = cssColour("--accent"); context.lineWidth = 1.5 * ratio;
    if (this.look.strip === "when") {
      context.beginPath(); context.moveTo(x, this.top - 4); context.lineTo(x, this.bottom); context.stroke();
    }
    if (selected >= 0) {
      const step = 1 / this.order.length, at = this.row.get(selected) * step;
      context.lineWidth = 1;
      if (this.look.strip === "when") {
        const y = this.top + at * (this.bottom - this.top);
        context.strokeRect(this.left, y - 1, this.right - this.left, step * (this.bottom - this.top) + 2);
      } else {
        const x = this.left + at * (this.right - this.left);
        context.strokeRect(x - 1, this.top, step * (this.right - this.left) + 2, this.bottom - this.top);
      }
    }
  }

  drawGround(width, height, ratio) {
    this.ground.width = width; this.ground.height = height; this.stale = false;
    const context = this.ground.getContext("2d");
    context.font = `${10.5 * ratio}px system-ui, sans-serif`; context.fillStyle = context.strokeStyle = cssColour("--muted");
    context.lineWidth = 1;
    if (this.look.strip === "when") this.drawWhen(context, ratio); else this.drawTotals(context, ratio);
  }

  drawAxis(context, ratio, isVertical) {
    const step = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200].find((s) => this.span / s <= (isVertical ? 4 : 12)) || 500;
    context.textBaseline = "middle";
    for (let t = 0; t <= this.span * 1.0001; t += step) {
      const share = t / this.span, label = `${+t.toFixed(1)}`;
      context.beginPath();
      if (isVertical) {
        const y = this.bottom - share * (this.bottom - this.top);
        context.textAlign = "right"; context.fillText(label, this.left - 6 * ratio, y);
        context.moveTo(this.left, y); context.lineTo(this.right, y);
      } else {
        const x = this.left + share * (this.right - this.left);
        context.textAlign = "center"; context.fillText(label, x, this.bottom + 10 * ratio);
        context.moveTo(x, this.top); context.lineTo(x, this.bottom);
      }
      context.save(); context.globalAlpha = 0.25; context.stroke(); context.restore();
    }
    context.textAlign = "left";
    if (isVertical) context.fillText("s", 4 * ratio, this.top + 4 * ratio);
    else { context.fillText("robots", 2 * ratio, this.top + 6 * ratio); context.fillText("s", this.left - 12 * ratio, this.bottom + 10 * ratio); }
  }

  drawWhen(context, ratio) {
    this.drawAxis(context, ratio, false);
    const colours = PALETTES[this.look.palette][this.look.theme];
    const tall = (this.bottom - this.top) / this.order.length, wide = (this.right - this.left) / this.span;
    const bar = (robot, from, until, state, share) => {
      const y = this.top + this.row.get(robot) * tall, inset = tall > 3 ? 0.5 : 0;
      context.fillStyle = colours[state];
      context.globalAlpha = state === WAITING ? 0.75 : 1;
      context.fillRect(this.left + from * wide, y + inset + (tall - 2 * inset) * (1 - share) / 2, Math.max((until - from) * wide, 0.6), (tall - 2 * inset) * share);
    };
    for (const robot of this.order) {
      let t = 0;
      for (const piece of this.route.pieces[robot]) {
        if (piece.from > t) bar(robot, t, piece.from, WAITING, 0.6);
        bar(robot, piece.from, piece.until, piece.state, 1);
        t = piece.until;
      }
    }
    context.globalAlpha = 1;
  }

  drawTotals(context, ratio) {
    this.drawAxis(context, ratio, true);
    const colours = PALETTES[this.look.palette][this.look.theme];
    const wide = (this.right - this.left) / this.order.length, size = Math.max(1.6 * ratio, Math.min(0.35 * wide, 3.2 * ratio));
    context.fillStyle = cssColour("--muted"); context.textAlign = "center";
    context.fillText(this.look.sort === "time" ? "robots, the last to arrive first" : `robots 1 to ${this.order.length}`, (this.left + this.right) / 2, this.bottom + 11 * ratio);
    for (const [row, robot] of this.order.entries()) {
      const seconds = this.route.times(robot), x = this.left + (row + 0.5) * wide;
      for (const state of [WAITING, MOVING, ROTATING]) {
        if (!this.route.pieces[robot].length) continue;
        const y = this.bottom - (seconds[state] / this.span) * (this.bottom - this.top);
        context.fillStyle = colours[state]; context.beginPath();
        if (state === ROTATING) context.arc(x, y, size, 0, TURN);
        else if (state === MOVING) context.rect(x - size, y - size, 2 * size, 2 * size);
        else { context.moveTo(x, y - 1.2 * size); context.lineTo(x + 1.2 * size, y + size); context.lineTo(x - 1.2 * size, y + size); }
        context.fill();
      }
    }
  }
}
