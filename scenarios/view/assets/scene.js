// The large panel: the world from above, with the robots in it and what crosses the air.

import { bytesText } from "ropeteam/model";
import { Panel, cross, kindColour } from "ropeteam/panel";
import { Picture, colourRange } from "ropeteam/shade";

// Where a robot's name stands, from its mark: to its side (-1, 0, 1), and down in CSS pixels.
const NAMES = [[0, 17], [0, -18], [1, 0], [-1, 0], [1, 15], [-1, 15], [1, -16], [-1, -16], [0, 30], [0, -31]];
const MARK_PX = 8; // half of what a mark takes, its turned line left aside
const ABOVE = [[0, -18], [0, -31]]; // where it is told what a robot sends, if there is room

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
    this.said = [];
    this.links(t, slack_s, theme);
    const there = this.run.robots.filter((robot) => robot.stateAt(t) !== "waiting");
    for (const robot of there) this.mark(robot, t, theme);
    for (const robot of there) this.name(robot, t, theme);
    for (const [words, px, py, colour] of this.said) this.place(words, px, py, ABOVE, colour, theme);
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
    for (const [colour, width] of [[theme.panel, 5], [theme.ink, 2]]) {
      ink.lineWidth = width;
      ink.strokeStyle = colour;
      cross(ink, px, py, 6);
    }
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
        ink.globalAlpha = verdict === "" && frame.end < t ? 0.4 : 1; // nobody has said yet
        ink.setLineDash(heard ? [] : [3, 5]);
        ink.beginPath();
        ink.moveTo(ax, ay);
        ink.lineTo(ax + end * (bx - ax), ay + end * (by - ay));
        ink.stroke();
        ink.setLineDash([]);
        ink.globalAlpha = 1;
        if (!heard) cross(ink, ax + end * (bx - ax), ay + end * (by - ay), 4);
      }
      if (told.size < 3 && !told.has(frame.from)) {
        told.add(frame.from);
        this.said.push([`${frame.kind} ${bytesText(frame.bytes)}`, ax, ay, kindColour(frame.kind)]);
      }
    }
  }

  // Marks come before all names: none may hide a name.
  mark(robot, t, theme) {
    const state = robot.stateAt(t);
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
    this.taken.push([px - MARK_PX, px + MARK_PX, py - MARK_PX, py + MARK_PX]);
  }

  name(robot, t, theme) {
    const state = robot.stateAt(t);
    const [x, y] = robot.poseAt(t);
    const [px, py] = this.at(x, y);
    const words = state === "alive" ? robot.name : `${robot.name} (${state})`;
    const number = robot.name.match(/\d+$/)?.[0]; // where names don't fit, colours and numbers must do
    this.place(words, px, py, NAMES, theme.ink, theme) || (number && this.place(number, px, py, NAMES, theme.ink, theme));
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
