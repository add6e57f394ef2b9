// A run as it was at any moment: rows are taken in as they come, and looked up by time.

import { grow } from "ropeteam/data";

const KINDS = ["map", "anchor", "digest", "status", "tether", "fix", "stop"];
const LONGEST_S = 60; // no frame is looked for that began longer ago

export class Run {
  constructor(head) {
    this.head = head;
    const { rows, cols } = head.frame;
    this.cells = rows * cols;
    this.truth = new Uint16Array(head.truth);
    this.robots = head.robots.map((robot, index) => new Robot(robot, index, this.cells));
    this.frames = [];
    this.events = [];
    this.end = null;
    this.last_s = 0;
    this.revision = 0;
  }

  get isPlanar() {
    return this.head.kind === "planar";
  }

  // Takes in rows (see scenarios/view/reel.py).
  take(rows) {
    for (const row of rows.moves ?? []) this.robots[row[0]].move(row);
    for (const row of rows.states ?? []) this.robots[row[0]].states.push(row.slice(1));
    for (const row of rows.plans ?? []) this.robots[row[0]].plans.push(row.slice(1));
    for (const row of rows.growth ?? []) this.robots[row[0]].growth.push(row.slice(1));
    for (const row of rows.looks ?? []) this.robots[row[0]].looks.push(row.slice(1));
    for (const row of rows.maps ?? []) this.robots[row[0]].samples.push(row.slice(1));
    for (const row of rows.tx ?? []) this.send(row);
    for (const row of rows.rx ?? []) this.arrive(row);
    for (const row of rows.events ?? []) this.events.push(row);
    if (rows.tx) this.frames.sort((a, b) => a.start - b.start);
    if (rows.events) this.events.sort((a, b) => a[1] - b[1]);
    this.revision += 1;
  }

  send([from, number, kind, bytes, start, end, chosen]) {
    const robot = this.robots[from];
    const total = (robot.frames.at(-1)?.total ?? 0) + bytes;
    const frame = { from, number, kind, bytes, start, end, chosen, total, heard: new Map() };
    robot.sent.set(number, frame);
    robot.frames.push(frame);
    this.frames.push(frame);
  }

  arrive([to, from, number, at, verdict]) {
    this.robots[from].sent.get(number)?.heard.set(to, [at, verdict]);
  }

  advance(now_s) {
    this.last_s = Math.max(this.last_s, now_s);
  }

  // Frames on their way at a moment, or up to `slack_s` before it.
  onAir(t, slack_s) {
    const found = [];
    for (let i = upTo(this.frames, t, (f) => f.start) - 1; i >= 0; i -= 1) {
      const frame = this.frames[i];
      if (frame.start < t - slack_s - LONGEST_S) break;
      if (frame.end + slack_s >= t) found.push(frame);
    }
    return found;
  }

  kinds() {
    const found = new Set(this.frames.map((frame) => frame.kind));
    const known = KINDS.filter((kind) => found.has(kind));
    return [...known, ...[...found].filter((kind) => !KINDS.includes(kind)).sort()];
  }
}

class Robot {
  constructor(head, index, cells) {
    Object.assign(this, head);
    this.index = index;
    this.moves = [];
    this.states = [];
    this.plans = [];
    this.growth = [];
    this.looks = [];
    this.samples = [];
    this.frames = [];
    this.sent = new Map();
    this.map = new GrownMap(cells, this.growth);
  }

  // A motion that was published later overrules what of earlier ones has not begun.
  move([, start, end, from, to, tether0, tether1]) {
    if (from === undefined) {
      const pose = this.poseAt(start);
      const tether = this.tetherAt(start);
      [end, from, to, tether0, tether1] = [start, pose, pose, tether, tether];
    }
    while (this.moves.length > 0 && this.moves.at(-1).start > start) this.moves.pop();
    this.moves.push({ start, end, from, to, tether0, tether1 });
  }

  moveAt(t) {
    return this.moves[upTo(this.moves, t, (m) => m.start) - 1];
  }

  poseAt(t) {
    const move = this.moveAt(t);
    if (!move) return this.start;
    const share = shareAt(move, t);
    const turn = Math.atan2(Math.sin(move.to[3] - move.from[3]), Math.cos(move.to[3] - move.from[3]));
    const [x, y, z] = [0, 1, 2].map((i) => move.from[i] + share * (move.to[i] - move.from[i]));
    return [x, y, z, move.from[3] + share * turn];
  }

  tetherAt(t) {
    const move = this.moveAt(t);
    return move ? move.tether0 + shareAt(move, t) * (move.tether1 - move.tether0) : 0;
  }

  // Its way up to a moment, as [x, y] points.
  trackTo(t) {
    const track = [[this.start[0], this.start[1]]];
    for (const move of this.moves) {
      if (move.start > t) break;
      const share = shareAt(move, t);
      track.push([0, 1].map((i) => move.from[i] + share * (move.to[i] - move.from[i])));
    }
    return track;
  }

  stateAt(t) {
    if (this.joins_s > t) return "waiting";
    return this.states[upTo(this.states, t, (s) => s[0]) - 1]?.[1] ?? "alive";
  }

  planAt(t) {
    if (this.stateAt(t) !== "alive") return {};
    return this.plans[upTo(this.plans, t, (p) => p[0]) - 1]?.[1] ?? {};
  }

  // The look that it takes at a moment (its exposure comes at the look's end), or null.
  lookAt(t, look_s) {
    const look = this.looks[upTo(this.looks, t + look_s, (l) => l[0]) - 1];
    return look && look[0] >= t ? look : null;
  }

  looksTo(t) {
    return upTo(this.looks, t, (l) => l[0]);
  }

  bytesTo(t) {
    return this.frames[upTo(this.frames, t, (frame) => frame.start) - 1]?.total ?? 0;
  }
}

// One robot's map as it grew; going on is cheap, going back begins anew.
class GrownMap {
  constructor(cells, steps) {
    this.levels = new Uint16Array(cells);
    this.own = new Uint8Array(cells);
    this.steps = steps;
    this.done = 0;
    this.mapped = 0;
    this.revision = 0;
  }

  // Lays all that grew up to a moment; says whether anything changed.
  to(t) {
    const before = this.done;
    if (this.done > 0 && this.steps[this.done - 1][0] > t) this.clear();
    const n = upTo(this.steps, t, (s) => s[0]);
    while (this.done < n) {
      const [, mapped, first, data] = this.steps[this.done];
      if (first) this.wipe();
      grow(data, this.levels, this.own);
      this.mapped = mapped;
      this.done += 1;
    }
    if (before !== this.done) this.revision += 1;
    return before !== this.done;
  }

  clear() {
    this.wipe();
    this.done = 0;
    this.mapped = 0;
  }

  wipe() {
    this.levels.fill(0);
    this.own.fill(0);
  }
}

function shareAt(move, t) {
  if (t >= move.end) return 1;
  return t <= move.start ? 0 : (t - move.start) / (move.end - move.start);
}

// How many of the rows (sorted by `key`) are at or before a moment.
export function upTo(rows, t, key) {
  let low = 0;
  let high = rows.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (key(rows[middle]) <= t) low = middle + 1;
    else high = middle;
  }
  return low;
}

export function clock(t) {
  const whole = Math.max(0, Math.floor(t + 1e-6));
  const two = (n) => String(n).padStart(2, "0");
  return `${Math.floor(whole / 3600)}:${two(Math.floor(whole / 60) % 60)}:${two(whole % 60)}`;
}

export function bytesText(bytes) {
  return bytes < 1000 ? `${bytes} B` : `${(bytes / 1000).toFixed(1)} kB`;
}
