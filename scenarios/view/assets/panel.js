// What all panels from above have in common, and the panel of one robot's own map.

import { Picture } from "ropeteam/shade";

const PAD = 10; // CSS pixels around a map
const LINE_PX = 13; // height of a line of words
const BESIDE_PX = 9; // from a point to words at its side
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
export class Panel {
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
    this.taken = []; // boxes of words: left, right, top, bottom
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

  // Writes words at the first place, of some about a point, where they cover nothing that is taken;
  // returns whether there was one. A place is a side (-1, 0, 1) and a height.
  place(words, px, py, places, colour, theme) {
    const half = this.ink.measureText(words).width / 2 + 2;
    for (const [side, height] of places) {
      const middle = px + side * (half + BESIDE_PX);
      const box = [middle - half, middle + half, py + height - LINE_PX / 2, py + height + LINE_PX / 2];
      if (this.taken.some((b) => b[0] < box[1] && box[0] < b[1] && b[2] < box[3] && box[2] < b[3])) continue;
      this.taken.push(box);
      this.text(words, middle, py + height, colour, theme, "center");
      return true;
    }
    return false;
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

export function cross(ink, x, y, size) {
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
