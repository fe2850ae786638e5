import assert from 'node:assert/strict';
import test from 'node:test';

import { ConsumerError, printable } from '../lib/errors.js';
import { parseStrictJson } from '../lib/strict-json.js';

const parse = (text) => parseStrictJson(new TextEncoder().encode(text), 'file.json', ConsumerError);

test('objects are parsed', () => {
  assert.deepEqual(parse('{"a": [1, {"a": "}\\"{", "b": null}], "b": {}}'), { a: [1, { a: '}"{', b: null }], b: {} });
});

test('a key that occurs twice is refused, also if one of them is escaped', () => {
  for (const text of ['{"a": 1, "a": 2}', '{"x": [{"a": 1, "\\u0061": 2}]}', '{"a":{"b":1},"a" :2}']) {
    assert.throws(() => parse(text), /file\.json: expected each key once in an object; found "a" twice/);
  }
});

test('one key in several objects, and a value that equals a key, are accepted', () => {
  assert.doesNotThrow(() => parse('[{"a": "a"}, {"a": ["a", "a"]}, {"b": {"a": "a"}, "a": 1}]'));
});

test('what is not JSON in UTF-8 is refused', () => {
  assert.throws(() => parse(''), /expected JSON; found an empty file/);
  assert.throws(() => parse('{"a": NaN}'), /expected JSON; found text that is not/);
  assert.throws(() => parse('\ufeff{}'), /found UTF-8 with a byte order mark/);
  assert.throws(
    () => parseStrictJson(Uint8Array.of(0x22, 0xff, 0x22), 'file.json', ConsumerError),
    /expected UTF-8 text/,
  );
});

test('messages have no control characters', () => {
  assert.equal(printable('a\u001b[31m\u202eb\n'), 'a\\u001b[31m\\u202eb\\u000a');
  assert.ok(printable('x'.repeat(10_000)).length < 500);
});
