// The panels from above: the world with the robots in it, and each robot's own map.

import { Picture, colourRange } from "ropeteam/shade";
import { bytesText } from "ropeteam/model";

const PAD = 10; // CSS pixels around a map
const REPAINT_MS = 120; // while time runs, maps are painted anew no more often

export const KIND_COLOURS = {
  map: "#7868e6",
  anchor: "#2f9fd0",
  digest: "#b89b1f",
  status: "#2f9e8f",
  tether: "#cc5a68",
  fix: "#8a8a2e",
  stop: "#a33a70",
};
export const kindColour = (kind) => KIND_COLOURS[kind] ?? "#888888";

// A canvas as sharp as the screen, with a transform from the world's metres.
class Panel {
  constructor(canvas, head) {
    this.canvas = canvas;
    this.head = head;
    this.ink = canvas.getContext("2d");
    const { x_m, y_m, cell_m, rows, cols } = head.frame;
    this.extent = [x_m, y_m, cols * cell_m, rows * cell_m];
  }

  // Whether it is time to paint a map anew that has changed.
  isDue(hurried) {
    const now = performance.now();
    if (hurried && now < (this.paintedAt ?? 0) + REPAINT_MS) return false;
    this.paintedAt = now;
    return true;
  }

  begin() {
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (this.canvas.width !== Math.round(width * ratio) || this.canvas.height !== Math.round(height * ratio)) {
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
    }
    this.ink.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.ink.clearRect(0, 0, width, height);
    const [, , wide, high] = this.extent;
    this.scale = Math.min((width - 2 * this.pad) / wide, (height - 2 * this.pad) / high);
    this.left = (width - wide * this.scale) / 2;
    this.bottom = (height + high * this.scale) / 2;
    return width > 2 * this.pad && height > 2 * this.pad;
  }

  get pad() {
    return PAD;
  }

  at(x, y) {
    const [west, south] = this.extent;
    return [this.left + (x - west) * this.scale, this.bottom - (y - south) * this.scale];
  }

  lay(picture, alpha = 1) {
    const [, , wide, high] = this.extent;
    this.ink.globalAlpha = alpha;
    this.ink.imageSmoothingEnabled = true;
    this.ink.imageSmoothingQuality = "high";
    const size = [wide * this.scale, high * this.scale];
    this.ink.drawImage(picture.canvas, this.left, this.bottom - size[1], ...size);
    this.ink.globalAlpha = 1;
  }

  frame(colour) {
    const [, , wide, high] = this.extent;
    this.ink.strokeStyle = colour;
    this.ink.lineWidth = 1;
    this.ink.strokeRect(this.left, this.bottom - high * this.scale, wide * this.scale, high * this.scale);
  }

  path(points) {
    this.ink.beginPath();
    points.forEach(([x, y], i) => this.ink[i ? "lineTo" : "moveTo"](...this.at(x, y)));
  }

  marker(x, y, robot, size, theme) {
    const [px, py] = this.at(x, y);
    const ink = this.ink;
    ink.beginPath();
    if (robot.role === "anchor") ink.rect(px - size * 0.85, py - size * 0.85, size * 1.7, size * 1.7);
    else if (robot.role === "cliffbot") {
      ink.moveTo(px - size * 1.1, py - size * 0.8);
      ink.lineTo(px + size * 1.1, py - size * 0.8);
      ink.lineTo(px, py + size * 1.15);
      ink.closePath();
    } else ink.arc(px, py, size, 0, 2 * Math.PI);
    ink.fillStyle = robot.colour;
    ink.fill();
    ink.lineWidth = 2;
    ink.strokeStyle = theme.panel;
    ink.stroke();
  }

  wedge(x, y, heading, sensor) {
    const [px, py] = this.at(x, y);
    const half = sensor.fov_rad / 2;
    this.ink.beginPath();
    this.ink.moveTo(px, py);
    this.ink.arc(px, py, sensor.range_m * this.scale, -heading - half, -heading + half);
    this.ink.closePath();
  }

  text(words, px, py, colour, theme, align = "left") {
    const ink = this.ink;
    ink.textAlign = align;
    ink.lineJoin = "round";
    ink.lineWidth = 3.5;
    ink.strokeStyle = theme.panel;
    ink.strokeText(words, px, py);
    ink.fillStyle = colour;
    ink.fillText(words, px, py);
  }
}

// The large panel.
export class World extends Panel {
  constructor(canvas, run) {
    super(canvas, run.head);
    this.run = run;
    this.range = colourRange(run.truth);
    this.truth = new Picture(run.head, this.range);
    this.map = new Picture(run.head, this.range);
    this.painted = "";
    this.choice = "team";
  }

  // Paints the chosen map where it has changed: a robot's, or whatever any robot knows.
  repaint(hurried) {
    const { robots } = this.run;
    const mark = `${this.choice} ${robots.map((robot) => robot.map.revision).join()}`;
    if (mark === this.painted || !this.isDue(hurried)) return;
    this.painted = mark;
    if (this.choice === "truth") return;
    if (this.choice !== "team") {
      this.map.paint(robots[this.choice].map.levels, { own: robots[this.choice].map.own });
      return;
    }
    const union = new Uint16Array(this.run.cells);
    for (const robot of robots) {
      const levels = robot.map.levels;
      for (let at = 0; at < union.length; at += 1) union[at] ||= levels[at];
    }
    this.map.paint(union);
  }

  // Draws a moment; frames that are over stay lit for `slack_s`.
  draw(t, slack_s, theme, hurried) {
    if (this.theme !== theme) {
      this.theme = theme;
      this.truth.paint(this.run.truth, { grey: this.run.isPlanar ? theme.floor : theme.rock });
    }
    if (!this.begin()) return;
    this.repaint(hurried);
    this.lay(this.truth, this.choice === "truth" ? 0.95 : 0.5);
    if (this.choice !== "truth") this.lay(this.map);
    this.frame(theme.line);
    this.ink.font = theme.font;
    this.ink.textBaseline = "middle";
    this.goal(theme);
    this.clip();
    for (const robot of this.run.robots) this.track(robot, t);
    for (const robot of this.run.robots) this.plan(robot, t);
    this.tethers(t, theme);
    for (const robot of this.run.robots) this.view(robot, t);
    this.ink.restore();
    this.links(t, slack_s, theme);
    for (const robot of this.run.robots) this.robot(robot, t, theme);
    this.ruler(theme);
  }

  // Draws nothing beside the map, until `restore`.
  clip() {
    const [, , wide, high] = this.extent;
    this.ink.save();
    this.ink.beginPath();
    this.ink.rect(this.left, this.bottom - high * this.scale, wide * this.scale, high * this.scale);
    this.ink.clip();
  }

  goal(theme) {
    if (!this.head.goal_m) return;
    const [px, py] = this.at(...this.head.goal_m);
    const ink = this.ink;
    ink.lineWidth = 2;
    ink.strokeStyle = theme.ink;
    ink.beginPath();
    ink.moveTo(px - 6, py - 6);
    ink.lineTo(px + 6, py + 6);
    ink.moveTo(px + 6, py - 6);
    ink.lineTo(px - 6, py + 6);
    ink.stroke();
    this.text("goal", px + 10, py, theme.ink, theme);
  }

  track(robot, t) {
    if (robot.stateAt(t) === "waiting") return;
    this.path(robot.trackTo(t));
    this.ink.strokeStyle = robot.colour;
    this.ink.globalAlpha = 0.8;
    this.ink.lineWidth = 1.6;
    this.ink.stroke();
    this.ink.fillStyle = robot.colour;
    for (let i = robot.looksTo(t) - 1; i >= 0; i -= 1) {
      const [, x, y] = robot.looks[i];
      this.ink.beginPath();
      this.ink.arc(...this.at(x, y), 1.8, 0, 2 * Math.PI);
      this.ink.fill();
    }
    this.ink.globalAlpha = 1;
  }

  plan(robot, t) {
    const plan = robot.planAt(t);
    const ink = this.ink;
    ink.strokeStyle = robot.colour;
    ink.lineWidth = 1.4;
    ink.setLineDash([5, 4]);
    if (plan.way) {
      const [x, y] = robot.poseAt(t);
      const [endX, endY] = plan.way.at(-1);
      this.path(plan.way.length > 1 ? [[x, y], ...plan.way.slice(1)] : [[x, y], [endX, endY]]);
      ink.stroke();
      this.wedge(endX, endY, plan.heading, this.head.sensor);
      ink.stroke();
    } else if (plan.claim) {
      ink.beginPath();
      ink.arc(...this.at(plan.claim[0], plan.claim[1]), plan.claim[2] * this.scale, 0, 2 * Math.PI);
      ink.stroke();
    }
    ink.setLineDash([]);
  }

  tethers(t, theme) {
    const bot = this.run.robots.find((robot) => robot.role === "cliffbot");
    if (!bot) return;
    const [bx, by] = bot.poseAt(t);
    for (const anchor of this.run.robots.filter((robot) => robot.role === "anchor")) {
      const [x, y] = anchor.poseAt(t);
      this.path([[x, y], [bx, by]]);
      this.ink.lineWidth = 1;
      this.ink.strokeStyle = theme.ink;
      this.ink.globalAlpha = 0.55;
      this.ink.stroke();
      this.ink.globalAlpha = 1;
    }
  }

  view(robot, t) {
    const look = robot.stateAt(t) === "alive" && robot.lookAt(t, this.head.sensor.look_s);
    if (!look) return;
    const [x, y, , yaw] = robot.poseAt(look[0]);
    this.wedge(x, y, yaw + look[3], this.head.sensor);
    this.ink.fillStyle = robot.colour;
    this.ink.globalAlpha = 0.28;
    this.ink.fill();
    this.ink.globalAlpha = 1;
  }

  // Links light up with what crosses them; a frame that is lost ends in a cross half-way.
  links(t, slack_s, theme) {
    const ink = this.ink;
    const frames = this.run.onAir(t, slack_s);
    const told = new Set();
    for (const frame of frames) {
      const from = this.run.robots[frame.from].poseAt(t);
      const [ax, ay] = this.at(from[0], from[1]);
      for (const robot of this.run.robots) {
        if (robot.index === frame.from || robot.stateAt(t) === "waiting") continue;
        const verdict = frame.heard.get(robot.index)?.[1] ?? "";
        const to = robot.poseAt(t);
        const [bx, by] = this.at(to[0], to[1]);
        const heard = verdict === "" || verdict === "delivered";
        const end = heard ? 1 : 0.5;
        ink.strokeStyle = kindColour(frame.kind);
        ink.lineWidth = heard ? Math.min(1.5 + frame.bytes / 80, 4.5) : 1.2;
        ink.setLineDash(heard ? [] : [3, 5]);
        ink.beginPath();
        ink.moveTo(ax, ay);
        ink.lineTo(ax + end * (bx - ax), ay + end * (by - ay));
        ink.stroke();
        ink.setLineDash([]);
        if (!heard) cross(ink, ax + end * (bx - ax), ay + end * (by - ay), 4);
      }
      if (told.size < 3 && !told.has(frame.from)) {
        told.add(frame.from);
        this.text(`${frame.kind} ${bytesText(frame.bytes)}`, ax, ay - 18, kindColour(frame.kind), theme, "center");
      }
    }
  }

  robot(robot, t, theme) {
    const state = robot.stateAt(t);
    if (state === "waiting") return;
    const [x, y, , yaw] = robot.poseAt(t);
    const [px, py] = this.at(x, y);
    const ink = this.ink;
    ink.globalAlpha = state === "alive" ? 1 : 0.55;
    ink.beginPath();
    ink.moveTo(px, py);
    ink.lineTo(px + 13 * Math.cos(yaw), py - 13 * Math.sin(yaw));
    ink.lineWidth = 3;
    ink.strokeStyle = robot.colour;
    ink.stroke();
    this.marker(x, y, robot, 6, theme);
    ink.globalAlpha = 1;
    if (state !== "alive") {
      ink.strokeStyle = theme.bad;
      ink.lineWidth = 2.5;
      cross(ink, px, py, 8);
    }
    const words = state === "alive" ? robot.name : `${robot.name} (${state})`;
    this.text(words, px, py + 17, theme.ink, theme, "center");
  }

  ruler(theme) {
    const [, , wide] = this.extent;
    const steps = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];
    const length = steps.findLast((step) => step <= wide / 5) ?? steps[0];
    const [x, y] = [this.left + 12, this.bottom - 14];
    for (const [colour, width] of [[theme.panel, 5], [theme.ink, 2]]) {
      this.ink.strokeStyle = colour;
      this.ink.lineWidth = width;
      this.ink.beginPath();
      this.ink.moveTo(x, y);
      this.ink.lineTo(x + length * this.scale, y);
      this.ink.stroke();
    }
    this.text(`${length} m`, x + length * this.scale + 7, y, theme.ink, theme);
  }
}

function cross(ink, x, y, size) {
  ink.beginPath();
  ink.moveTo(x - size, y - size);
  ink.lineTo(x + size, y + size);
  ink.moveTo(x + size, y - size);
  ink.lineTo(x - size, y + size);
  ink.stroke();
}

// One robot's team map: what it measured itself in full colour, what it was told paler.
export class RobotMap extends Panel {
  constructor(canvas, run, robot, range) {
    super(canvas, run.head);
    this.run = run;
    this.robot = robot;
    this.picture = new Picture(run.head, range);
    this.painted = -1;
  }

  get pad() {
    return 4;
  }

  draw(t, theme, hurried) {
    if (!this.begin()) return;
    const { map } = this.robot;
    if (this.painted !== map.revision && this.isDue(hurried)) {
      this.painted = map.revision;
      this.picture.paint(map.levels, { own: map.own });
    }
    this.lay(this.picture);
    this.frame(theme.line);
    if (this.robot.stateAt(t) === "waiting") return;
    const [x, y] = this.robot.poseAt(t);
    this.marker(x, y, this.robot, 4.5, theme);
  }
}
