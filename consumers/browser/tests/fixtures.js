// Files that tests/helpers/browser_fixtures.py of the toolkit writes: bundles, a drive, images and resized images.

import { readFile } from 'node:fs/promises';
import path from 'node:path';

import { readBundle } from '../lib/bundle.js';
import { Folder } from '../lib/folder.js';
import { openFolder } from '../node/engine.js';

const root = process.env.DUOSPACENET_FIXTURES;

/** The options of a test that needs the files. */
export const needsFixtures = { skip: root === undefined && 'DUOSPACENET_FIXTURES is not set; see README.md' };

export function fixture(...parts) {
  return path.join(root, ...parts);
}

export async function fixtureJson(...parts) {
  return JSON.parse(await readFile(fixture(...parts), 'utf8'));
}

export async function fixtureBytes(...parts) {
  return new Uint8Array(await readFile(fixture(...parts)));
}

export async function bundleFixture(name = 'bundle') {
  return readBundle(await openFolder(fixture(name)));
}

/** A folder in memory. @param {Record<string, string | Uint8Array>} contents by path */
export function folderOf(contents, name = 'given') {
  const files = Object.entries(contents).map(([path, content]) => {
    const bytes = typeof content === 'string' ? new TextEncoder().encode(content) : content;
    return [path, { size: bytes.length, read: async () => bytes }];
  });
  return new Folder(name, new Map(files));
}
