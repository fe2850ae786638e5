// A manifest with its seal, as the toolkit writes it.

import { createHash } from 'node:crypto';

/** @returns {Uint8Array} the bytes of a manifest.json */
export function sealed(manifest) {
  const { sha256, ...fields } = manifest;
  const body = `${JSON.stringify(fields, null, 2).slice(0, -2)},\n`;
  const digest = createHash('sha256').update(body).digest('hex');
  return new TextEncoder().encode(`${body}  "sha256": "${digest}"\n}\n`);
}
