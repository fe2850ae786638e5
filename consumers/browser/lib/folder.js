// A folder of files in memory, on a disk, or dropped on the page. Paths have forward slashes, relative to the folder.

/** Names of files that operating systems add to folders. */
const CLUTTER = /(^|\/)(\.DS_Store|Thumbs\.db|desktop\.ini|\._[^/]*)$|(^|\/)__MACOSX\//i;

export class Folder {
  /**
   * @param {string} name for messages
   * @param {Map<string, {size: number, read: () => Promise<Uint8Array>}>} files by path
   */
  constructor(name, files) {
    this.name = name;
    this.files = files;
  }

  /** @param {[string, Blob][]} entries path and file, as the browser gives them */
  static ofFiles(name, entries) {
    const files = new Map();
    for (const [path, file] of entries) {
      const read = async () => new Uint8Array(await file.arrayBuffer());
      if (!CLUTTER.test(path)) files.set(path, { size: file.size, read });
    }
    return new Folder(name, files);
  }

  has(path) {
    return this.files.has(path);
  }

  get paths() {
    return [...this.files.keys()];
  }

  /** Return the content of a file that the folder has. */
  async read(path) {
    return this.files.get(path).read();
  }

  /** Return the subfolder at `path`, '' for the folder itself. */
  sub(path) {
    if (path === '') return this;
    const start = `${path}/`;
    const inside = [...this.files].filter(([name]) => name.startsWith(start));
    const name = this.name ? `${this.name}/${path}` : path;
    return new Folder(name, new Map(inside.map(([name, file]) => [name.slice(start.length), file])));
  }

  /** Return the paths of all subfolders that have a file `name`, '' for the folder itself. Shallow ones come first. */
  foldersWith(name) {
    const found = this.paths.filter((path) => path === name || path.endsWith(`/${name}`));
    const folders = found.map((path) => path.slice(0, Math.max(0, path.length - name.length - 1)));
    return folders.sort((one, other) => depth(one) - depth(other) || (one < other ? -1 : 1));
  }
}

function depth(path) {
  return path === '' ? 0 : path.split('/').length;
}

/**
 * Return a path without `.` and `..`, or undefined if it is absolute or leads out of its folder.
 * @param {string} path
 */
export function normalised(path) {
  if (path.startsWith('/') || path.includes('\\') || /^[a-z]:/i.test(path)) return undefined;
  const parts = [];
  for (const part of path.split('/')) {
    if (part === '..') {
      if (parts.pop() === undefined) return undefined;
    } else if (part !== '' && part !== '.') parts.push(part);
  }
  return parts.length > 0 ? parts.join('/') : undefined;
}
