// Command lines: arguments, exit codes and messages, as those of `duospacenet`.

import { parseArgs } from 'node:util';

import { BundleError, ConsumerError, printable } from '../lib/errors.js';

const EXIT = { usage: 2, input: 3, bundle: 4, output: 5, bug: 70 };

class UsageError extends Error {}

/**
 * Parse the arguments of this process.
 * @param {string} usage
 * @param {number} numFolders
 * @param {string[]} names of the options, each with a value
 */
export function parseCommand(usage, numFolders, names) {
  const options = Object.fromEntries(names.map((name) => [name, { type: 'string' }]));
  let parsed;
  try {
    parsed = parseArgs({ options, allowPositionals: true });
  } catch (error) {
    throw new UsageError(`${error.message}\nUsage: ${usage}`);
  }
  const { values, positionals } = parsed;
  if (positionals.length !== numFolders) throw new UsageError(`Usage: ${usage}`);
  if (values.threads !== undefined && !/^[1-9]\d{0,2}$/.test(values.threads)) {
    throw new UsageError(`--threads: expected an integer of at least 1; found ${values.threads}`);
  }
  return { ...values, folders: positionals, threads: values.threads && Number(values.threads) };
}

/** Run a command that returns its exit code, and end the process. Errors become messages on stderr. */
export async function runCommand(command) {
  process.stdout.on('error', () => process.exit(EXIT.output)); // such as a reader that has ended
  try {
    process.exitCode = await command();
  } catch (error) {
    const lines = error.message.split('\n').map(printable);
    process.stderr.write(`Error: ${lines.join('\n')}\n`);
    process.exitCode = exitCode(error);
    if (process.exitCode === EXIT.bug) process.stderr.write(`${error.stack}\n`);
  }
  process.exit(); // the threads of onnxruntime-web would keep the process alive
}

function exitCode(error) {
  if (error instanceof UsageError) return EXIT.usage;
  if (error instanceof BundleError) return EXIT.bundle;
  if (error instanceof ConsumerError) return EXIT.input;
  return error.code === undefined ? EXIT.bug : EXIT.output;
}
