// From the packed numbers of the page's data to arrays (dafw/views/report_fields.py packs them).

/** Return the bytes of a text in base64. */
export function bytesOf(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const raw = atob(text);
  const bytes = new Uint8Array(raw.length);
  for (let k = 0; k < raw.length; k += 1) bytes[k] = raw.charCodeAt(k);
  return bytes;
}

/** Return the bytes that were deflated and written in base64. */
export async function inflated(text) {
  const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Return packed numbers as an array of a type, such as Float32Array. */
export async function unpackNumbers(text, Type) {
  if (!text) return new Type(0);
  const bytes = await inflated(text);
  return new Type(bytes.buffer, bytes.byteOffset, bytes.byteLength / Type.BYTES_PER_ELEMENT);
}

/** Return a packed field as single-precision numbers, one row of nodes after the other; missing ones are NaN. */
export async function unpackField(field) {
  const bytes = await inflated(field.data);
  const count = field.rows * field.nodes;
  const missing = field.bits === 8 ? 255 : 65535;
  const whole = field.bits === 8 ? new Uint8Array(field.nodes) : new Uint16Array(field.nodes);
  const values = new Float32Array(count);
  for (let row = 0, k = 0; row < field.rows; row += 1) {
    for (let node = 0; node < field.nodes; node += 1, k += 1) {
      // Differences from the row before; the array's type takes what exceeds it off.
      whole[node] += field.bits === 8 ? bytes[k] : bytes[k] * 256 + bytes[count + k];
      values[k] = whole[node] === missing ? NaN : field.low + field.step * whole[node];
    }
  }
  return values;
}

/** Return which of the recorded rows of a field shows a row of the run: the latest one that is not after it. */
export function recordedRow(rows, row) {
  let found = 0;
  while (found + 1 < rows.length && rows[found + 1] <= row) found += 1;
  return found;
}
