// What a page is told, out of one piece of bytes (see scenarios/view/pack.py).

export function unpack(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const text = new TextDecoder().decode(new Uint8Array(buffer, 4, length));
  const start = 4 + length;
  return JSON.parse(text, (_, value) => {
    if (value === null || typeof value !== "object" || !("blob" in value)) return value;
    const [offset, size] = value.blob;
    return buffer.slice(start + offset, start + offset + size);
  });
}

// The data of a page that holds them itself: base64 of gzip, in an element of its own.
export async function embedded(element) {
  const text = atob(element.textContent);
  element.textContent = "";
  const bytes = Uint8Array.from(text, (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return unpack(await new Response(stream).arrayBuffer());
}

// One step of a map's growth: cells that changed with their levels, and cells newly measured by
// the robot itself, as runs of neighbours (see scenarios/view/growth.py).
export function grow(step, levels, own) {
  const [first, count, second] = new Uint32Array(step, 0, 3);
  const runs = new Uint32Array(step, 12, 2 * (first + second));
  const values = new Uint16Array(step.slice(12 + runs.byteLength), 0, count);
  let at = 0;
  let taken = 0;
  for (let run = 0; run < first; run += 1) {
    at += runs[2 * run];
    const n = runs[2 * run + 1];
    levels.set(values.subarray(taken, taken + n), at);
    at += n;
    taken += n;
  }
  at = 0;
  for (let run = first; run < first + second; run += 1) {
    at += runs[2 * run];
    const n = runs[2 * run + 1];
    own.fill(1, at, at + n);
    at += n;
  }
}
