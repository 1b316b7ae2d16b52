// Bytes out of a text of 15 bits a character: brdfatlas.figures.scripts.
"use strict";
window.atlasUnpack = (count, text) => {
  const out = new Uint8Array(count);
  let bits = 0, have = 0, place = 0;
  for (let i = 0; i < text.length; i++) {
    bits = bits << 15 | text.charCodeAt(i) - 0x3000;
    for (have += 15; have >= 8 && place < count; out[place++] = bits >> have & 255) have -= 8;
    bits &= (1 << have) - 1;
  }
  return out;
};
