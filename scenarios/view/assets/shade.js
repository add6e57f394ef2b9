// Maps as pictures: warm colours by height, lit from the north-west; floors in light and dark.
// The colours are those of scenarios/shading.py.

const STOPS = [
  [78, 40, 46],
  [122, 61, 52],
  [169, 95, 63],
  [209, 139, 90],
  [234, 186, 136],
  [248, 229, 201],
];
const SUN = [-0.5, 0.5, Math.SQRT1_2];
const EXAGGERATION = 1.6;

export function colourOf(share) {
  const at = Math.min(Math.max(share, 0), 1) * (STOPS.length - 1);
  const low = Math.min(Math.floor(at), STOPS.length - 2);
  return STOPS[low].map((from, i) => from + (at - low) * (STOPS[low + 1][i] - from));
}

export const scaleGradient = () =>
  `linear-gradient(to right, ${STOPS.map((stop) => `rgb(${stop.join()})`).join()})`;

// Heights between which colours are spread: all but the odd cell of the truth.
export function colourRange(truth) {
  const known = truth.filter((level) => level > 0).sort();
  if (known.length === 0) return [1, 2];
  const at = (share) => known[Math.floor(share * (known.length - 1))];
  return [at(0.005), Math.max(at(0.995), at(0.005) + 1)];
}

// How bright each cell is lit, 0 to 1; level ground 0.5. Noise is calmed over the eight neighbours.
function light(levels, { rows, cols, cell_m }, step_m) {
  const calm = calmed(levels, rows, cols);
  const lit = new Float32Array(rows * cols).fill(0.5);
  const scale = (EXAGGERATION * step_m) / (2 * cell_m);
  for (let row = 1; row < rows - 1; row += 1) {
    for (let at = row * cols + 1; at < (row + 1) * cols - 1; at += 1) {
      const east = (calm[at + 1] - calm[at - 1]) * scale;
      const north = (calm[at + cols] - calm[at - cols]) * scale;
      if (Number.isNaN(east + north)) continue;
      const toSun = (-SUN[0] * east - SUN[1] * north + SUN[2]) / Math.hypot(east, north, 1);
      lit[at] = Math.min(Math.max(0.5 + (toSun - SUN[2]) * 0.75, 0), 1);
    }
  }
  return lit;
}

function calmed(levels, rows, cols) {
  const calm = new Float32Array(rows * cols).fill(NaN);
  for (let row = 0; row < rows; row += 1) {
    for (let col = 0; col < cols; col += 1) {
      const at = row * cols + col;
      if (levels[at] === 0) continue;
      let sum = 0;
      let count = 0;
      for (let r = Math.max(row - 1, 0); r <= Math.min(row + 1, rows - 1); r += 1) {
        for (let c = Math.max(col - 1, 0); c <= Math.min(col + 1, cols - 1); c += 1) {
          const level = levels[r * cols + c];
          if (level > 0) {
            sum += level;
            count += 1;
          }
        }
      }
      calm[at] = sum / count;
    }
  }
  return calm;
}

// A canvas of one pixel per cell, north up; unknown cells are clear.
export class Picture {
  constructor(head, range) {
    this.head = head;
    this.range = range;
    this.canvas = document.createElement("canvas");
    this.canvas.width = head.frame.cols;
    this.canvas.height = head.frame.rows;
    this.context = this.canvas.getContext("2d");
    this.image = this.context.createImageData(head.frame.cols, head.frame.rows);
  }

  paint(levels, { own = null, grey = null } = {}) {
    if (this.head.kind === "planar") this.floor(levels, own, grey);
    else this.ground(levels, own, grey);
    this.context.putImageData(this.image, 0, 0);
  }

  ground(levels, own, grey) {
    const { frame, scale } = this.head;
    const lit = light(levels, frame, scale.step);
    const [low, high] = this.range;
    this.each(levels, (level, at, out, pixel) => {
      const bright = lit[at];
      const base = grey ?? colourOf((level - low) / (high - low));
      for (let i = 0; i < 3; i += 1) {
        const shaded = bright < 0.5 ? base[i] * (0.35 + 1.3 * bright) : base[i] + (255 - base[i]) * (bright - 0.5);
        out[pixel + i] = shaded;
      }
      out[pixel + 3] = own && !own[at] ? HEARD : 255;
    });
  }

  floor(levels, own, grey) {
    const most = this.head.scale.most;
    this.each(levels, (level, at, out, pixel) => {
      const solid = (level - 1) / (most - 1);
      const [free, full] = grey ?? [FREE, SOLID];
      for (let i = 0; i < 3; i += 1) out[pixel + i] = free[i] + solid * (full[i] - free[i]);
      out[pixel + 3] = own && !own[at] ? HEARD : 255;
    });
  }

  each(levels, paint) {
    const { rows, cols } = this.head.frame;
    const out = this.image.data;
    for (let row = 0; row < rows; row += 1) {
      for (let col = 0; col < cols; col += 1) {
        const at = row * cols + col;
        const pixel = 4 * ((rows - 1 - row) * cols + col);
        if (levels[at] === 0) out[pixel + 3] = 0;
        else paint(levels[at], at, out, pixel);
      }
    }
  }
}

const FREE = [246, 236, 216];
const SOLID = [122, 61, 52];
const HEARD = 185; // what a robot was told, and did not see itself, is paler
