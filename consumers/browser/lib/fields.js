// Checks of the fields of a JSON file. Each returns the value, or throws an error that names the file and the field.

import { shown } from './errors.js';

export class Fields {
  /**
   * @param {object} values a JSON object
   * @param {string} where the file, for messages
   * @param {string} place the field of `values` in the file, '' for the whole file
   * @param {typeof import('./errors.js').ConsumerError} ErrorType
   * @param {string} remedy what to do about a wrong value
   */
  constructor(values, where, place, ErrorType, remedy) {
    Object.assign(this, { values, where, place, ErrorType, remedy });
    if (!isObject(values)) this.refuse('', 'an object', values);
  }

  /** The names of the fields. */
  get names() {
    return Object.keys(this.values);
  }

  /** The value of a field; undefined if it is absent. */
  get(name) {
    return Object.hasOwn(this.values, name) ? this.values[name] : undefined;
  }

  has(name) {
    return this.get(name) !== undefined && this.get(name) !== null;
  }

  object(name) {
    const place = this.place ? `${this.place}.${name}` : name;
    return new Fields(this.get(name), this.where, place, this.ErrorType, this.remedy);
  }

  text(name) {
    return this.check(name, 'text', (value) => typeof value === 'string');
  }

  /** Text that may be shown and written to files: without control characters. */
  name(name) {
    return this.check(name, 'text without control characters', isName);
  }

  nameList(name) {
    return this.check(name, 'a list of names', (value) => Array.isArray(value) && value.every(isName));
  }

  number(name, { above = -Infinity, most = Infinity } = {}) {
    const is = (value) => Number.isFinite(value) && value > above && value <= most;
    const limits = above === -Infinity ? '' : ` above ${above}`;
    return this.check(name, `a finite number${limits}`, is);
  }

  integer(name, least, most) {
    const is = (value) => Number.isInteger(value) && value >= least && value <= most;
    return this.check(name, `an integer from ${least} to ${most}`, is);
  }

  numbers(name, count) {
    const is = (value) => Array.isArray(value) && value.length === count && value.every(Number.isFinite);
    return this.check(name, `${count} finite numbers`, is);
  }

  matrix(name, rows, columns) {
    const isRow = (row) => Array.isArray(row) && row.length === columns && row.every(Number.isFinite);
    const is = (value) => Array.isArray(value) && value.length === rows && value.every(isRow);
    return this.check(name, `${rows} rows of ${columns} finite numbers`, is);
  }

  oneOf(name, choices) {
    const equals = (value, choice) => JSON.stringify(value) === JSON.stringify(choice);
    return this.check(name, choices.map(shown).join(' or '), (value) =>
      choices.some((choice) => equals(value, choice)),
    );
  }

  list(name, least = 0) {
    const is = (value) => Array.isArray(value) && value.length >= least;
    return this.check(name, `a list of at least ${least}`, is);
  }

  /** Refuse fields that are not listed. */
  only(names) {
    const unknown = this.names.find((name) => !names.includes(name));
    if (unknown !== undefined) this.refuse(unknown, `only the fields ${names.join(', ')}`, this.values[unknown]);
  }

  check(name, expected, is) {
    const value = this.get(name);
    if (!is(value)) this.refuse(name, expected, value);
    return value;
  }

  refuse(name, expected, found) {
    const place = [this.place, name].filter(Boolean).join('.');
    throw new this.ErrorType(`${this.where}${place ? `, field ${place}` : ''}`, expected, shown(found), this.remedy);
  }
}

export function isObject(value) {
  return typeof value === 'object' && value !== null && !Array.isArray(value);
}

function isName(value) {
  return typeof value === 'string' && value.isWellFormed?.() !== false && !/\p{Cc}/u.test(value);
}
