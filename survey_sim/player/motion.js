/* Where the robots are on a path, from its legs: the same physics as survey_sim.motion.
   A leg: wait until its start, turn in place, go along the robot's own x axis, then along its own y axis;
   the last `precise` mm of the leg's travel go at the precise speed. */

const ROTATING = 0, MOVING = 1, WAITING = 2, RESTING = 3;
const STATE_NAMES = ["rotating", "moving", "waiting", "at rest"];

class Route {
  /* begin: {x, y, theta} of every robot; legs: columns of equal length, sorted by robot and leg. */
  constructor(instrument, begin, legs) {
    this.begin = begin;
    this.n = begin.x.length;
    this.legs = legs;
    this.pieces = Array.from({ length: this.n }, () => []);
    this.legRows = Array.from({ length: this.n }, () => []);
    for (let row = 0; row < legs.robot.length; row++) this.addLeg(instrument, row);
    this.arrival = this.pieces.map((own) => (own.length ? own[own.length - 1].until : 0));
    this.duration = Math.max(0, ...this.arrival);
    this.ticks = [...new Set(legs.start)].sort((a, b) => a - b);
    this.sample = {
      x: new Float64Array(this.n), y: new Float64Array(this.n),
      theta: new Float64Array(this.n), state: new Uint8Array(this.n),
    };
  }

  addLeg(instrument, row) {
    const robot = this.legs.robot[row];
    const own = this.pieces[robot];
    const last = own[own.length - 1];
    let x = last ? last.x1 : this.begin.x[robot];
    let y = last ? last.y1 : this.begin.y[robot];
    const theta0 = last ? last.theta1 : this.begin.theta[robot];
    const theta1 = theta0 + this.legs.rotate[row];
    let t = this.legs.start[row];
    this.legRows[robot].push(row);
    const add = (seconds, x1, y1, from, to, state) => {
      if (seconds > 0) own.push({ from: t, until: t + seconds, x0: x, y0: y, x1, y1, theta0: from, theta1: to, state });
      t += seconds; x = x1; y = y1;
    };
    add(Math.abs(this.legs.rotate[row]) / instrument.rotation_speed_deg_s, x, y, theta0, theta1, ROTATING);
    const dx = this.legs.dx[row], dy = this.legs.dy[row];
    const alongX = Math.abs(dx), length = alongX + Math.abs(dy);
    const slowFrom = length - this.legs.precise[row];
    const angle = (theta1 * Math.PI) / 180, cos = Math.cos(angle), sin = Math.sin(angle);
    const x0 = x, y0 = y;
    let done = 0;
    for (const to of [Math.min(alongX, slowFrom), Math.max(alongX, slowFrom), length]) {
      if (to <= done) continue;
      const goneX = Math.min(to, alongX) * Math.sign(dx), goneY = Math.max(to - alongX, 0) * Math.sign(dy);
      const speed = done < slowFrom ? instrument.coarse_speed_mm_s : instrument.precise_speed_mm_s;
      const isEnd = to === length;
      const x1 = isEnd ? this.legs.x[row] : x0 + cos * goneX - sin * goneY;
      const y1 = isEnd ? this.legs.y[row] : y0 + sin * goneX + cos * goneY;
      add((to - done) / speed, x1, y1, theta1, theta1, MOVING);
      done = to;
    }
  }

  /* Positions, orientations and states of all robots at a time; the arrays are used again by the next call. */
  at(time) {
    const { x, y, theta, state } = this.sample;
    for (let i = 0; i < this.n; i++) {
      const own = this.pieces[i];
      let low = 0, high = own.length;
      while (low < high) {
        const middle = (low + high) >> 1;
        if (own[middle].from <= time) low = middle + 1; else high = middle;
      }
      const piece = own[low - 1];
      if (!piece) {
        x[i] = this.begin.x[i]; y[i] = this.begin.y[i]; theta[i] = this.begin.theta[i];
        state[i] = own.length ? WAITING : RESTING;
      } else if (time < piece.until) {
        const share = (time - piece.from) / (piece.until - piece.from);
        x[i] = piece.x0 + share * (piece.x1 - piece.x0);
        y[i] = piece.y0 + share * (piece.y1 - piece.y0);
        theta[i] = piece.theta0 + share * (piece.theta1 - piece.theta0);
        state[i] = piece.state;
      } else {
        x[i] = piece.x1; y[i] = piece.y1; theta[i] = piece.theta1;
        state[i] = low < own.length ? WAITING : RESTING;
      }
    }
    return this.sample;
  }

  /* Seconds that a robot turns, goes and waits until it comes to rest. */
  times(robot) {
    const seconds = [0, 0, 0];
    for (const piece of this.pieces[robot]) seconds[piece.state] += piece.until - piece.from;
    seconds[WAITING] = Math.max(0, this.arrival[robot] - seconds[ROTATING] - seconds[MOVING]);
    return seconds;
  }

  /* When a share of the robots that move have come to rest. */
  restTime(share) {
    const sorted = this.arrival.filter((t, i) => this.pieces[i].length).sort((a, b) => a - b);
    return sorted.length ? sorted[Math.max(Math.ceil(share * sorted.length - 1e-9), 1) - 1] : 0;
  }

  /* Number of the tick at a time, counted from 1; 0 before the first. */
  tickAt(time) {
    return this.ticks.filter((start) => start <= time + 1e-9).length;
  }
}

/* The two robots that are nearest to each other, and all that are nearer than a limit. */
function nearest(x, y, limit) {
  let least = Infinity, pair = [-1, -1];
  const near = [];
  for (let i = 1; i < x.length; i++) {
    for (let j = 0; j < i; j++) {
      const dx = x[i] - x[j], dy = y[i] - y[j], square = dx * dx + dy * dy;
      if (square < least) { least = square; pair = [j, i]; }
      if (square < limit * limit) near.push(i, j);
    }
  }
  return { distance: Math.sqrt(least), pair, near };
}
