// What the page carries as text, back to arrays.

export function read(id) {
  const element = document.getElementById(id);
  return element ? JSON.parse(element.textContent) : null;
}

export function bytes(base64) {
  const text = atob(base64);
  const out = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) out[i] = text.charCodeAt(i);
  return out;
}

async function inflated(compressed) {
  const stream = new Blob([compressed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Int32Array of rows times `width` numbers: what report/packed.py packed.
export async function unpacked({ data, width, bytes: size }) {
  const planes = await inflated(bytes(data));
  const values = planes.length / size;
  const rows = values / width;
  const out = new Int32Array(values);
  for (let column = 0; column < width; column++) {
    let sum = 0;
    for (let row = 0; row < rows; row++) {
      let unsigned = 0;
      for (let n = size - 1; n >= 0; n--) unsigned = (unsigned << 8) | planes[n * values + column * rows + row];
      sum += unsigned & 1 ? -(unsigned + 1) / 2 : unsigned / 2;
      out[row * width + column] = sum;
    }
  }
  return out;
}
