// The files that the user drops or picks, with their paths.

/**
 * Return all files of a drop, those in folders included.
 * @param {DataTransfer} transfer
 * @returns {Promise<[string, File][]>} path and file
 */
export async function droppedFiles(transfer) {
  // The entries must be taken before the first await: the browser clears the list then.
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  const loose = entries.length === 0 ? [...transfer.files] : [];
  const files = loose.map((file) => [file.name, file]);
  for (const entry of entries) await collect(entry, files);
  return files;
}

/** Return the files of a folder that was picked. */
export function pickedFiles(input) {
  return [...input.files].map((file) => [file.webkitRelativePath || file.name, file]);
}

async function collect(entry, files) {
  if (entry.isFile) {
    const file = await new Promise((resolve, reject) => entry.file(resolve, reject));
    files.push([entry.fullPath.replace(/^\//, ''), file]);
    return;
  }
  const reader = entry.createReader();
  for (;;) {
    // A reader gives at most 100 entries at a time.
    const children = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
    if (children.length === 0) return;
    for (const child of children) await collect(child, files);
  }
}
