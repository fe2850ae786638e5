// Strict JSON: UTF-8 without a byte order mark, and no key twice in an object. JSON.parse would use the last one.

import { shown } from './errors.js';

/**
 * Parse the bytes of a JSON file.
 * @param {Uint8Array} bytes
 * @param {string} where the file, for messages
 * @param {typeof import('./errors.js').ConsumerError} ErrorType
 */
export function parseStrictJson(bytes, where, ErrorType) {
  const text = decode(bytes, where, ErrorType);
  let value;
  try {
    value = JSON.parse(text);
  } catch (error) {
    const found = bytes.length === 0 ? 'an empty file' : `text that is not (${error.message})`;
    throw new ErrorType(where, 'JSON', found, 'Copy the file again.');
  }
  const repeated = firstRepeatedKey(text);
  if (repeated !== undefined) {
    throw new ErrorType(where, 'each key once in an object', `${shown(repeated)} twice`, 'Remove one of them.');
  }
  return value;
}

function decode(bytes, where, ErrorType) {
  if (bytes[0] === 0xef && bytes[1] === 0xbb && bytes[2] === 0xbf) {
    throw new ErrorType(where, 'UTF-8 text', 'UTF-8 with a byte order mark', 'Save it without the mark.');
  }
  try {
    return new TextDecoder('utf-8', { fatal: true }).decode(bytes);
  } catch {
    throw new ErrorType(where, 'UTF-8 text', `${bytes.length} bytes that are not`, 'Save the file as UTF-8.');
  }
}

/** Return the first key that occurs twice in an object of a valid JSON text, or undefined. */
function firstRepeatedKey(text) {
  const tokens = /"(?:[^"\\]|\\.)*"(\s*:)?|[{}]/g;
  const open = [];
  for (let match = tokens.exec(text); match !== null; match = tokens.exec(text)) {
    if (match[0] === '{') open.push(new Set());
    else if (match[0] === '}') open.pop();
    else if (match[1] !== undefined) {
      const key = JSON.parse(match[0].slice(0, match[0].lastIndexOf('"') + 1));
      const keys = open.at(-1);
      if (keys.has(key)) return key;
      keys.add(key);
    }
  }
  return undefined;
}
