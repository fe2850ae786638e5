// Errors that a user can act on. Each says where the problem is, what was expected, what was found, and what to do.

export class ConsumerError extends Error {
  /**
   * @param {string} where file, field or camera
   * @param {string} expected
   * @param {string} found
   * @param {string} remedy what to do; may be empty
   */
  constructor(where, expected, found, remedy = '') {
    const parts = [where, expected, found, remedy].map(printable);
    super(`${parts[0]}: expected ${parts[1]}; found ${parts[2]}.${parts[3] ? ` ${parts[3]}` : ''}`);
    this.name = this.constructor.name;
    [this.where, this.expected, this.found, this.remedy] = parts;
  }
}

/** The bundle is damaged, incomplete, or not one that this consumer can run. */
export class BundleError extends ConsumerError {}

/** The scene folder, an image or a frame is not valid. */
export class SceneError extends ConsumerError {}

const SHOWN_CHARACTERS = 400;

/** Return a text without control characters and lone surrogates, shortened to a few hundred characters. */
export function printable(text) {
  const wellFormed = String(text).toWellFormed?.() ?? String(text);
  const shown = wellFormed.replace(/[\p{Cc}\p{Cf}\p{Zl}\p{Zp}]/gu, (character) => {
    return `\\u${character.codePointAt(0).toString(16).padStart(4, '0')}`;
  });
  return shown.length > SHOWN_CHARACTERS ? `${shown.slice(0, SHOWN_CHARACTERS)}…` : shown;
}

/** Return any value as one short printable text. */
export function shown(value) {
  if (value === undefined) return 'nothing';
  const text = typeof value === 'number' || typeof value === 'bigint' ? String(value) : JSON.stringify(value);
  return printable(text.length > 80 ? `${text.slice(0, 80)}…` : text);
}
