// A scene folder: `scene.json` and image files. The format is described in docs/scene-folder.md.

import { SceneError, shown } from './errors.js';
import { Fields } from './fields.js';
import { normalised } from './folder.js';
import { decodeImage } from './image-files.js';
import { parseStrictJson } from './strict-json.js';
import { checkFrame } from './validation.js';

export const SCENE_NAME = 'scene.json';
const CALIBRATION = ['width_px', 'height_px', 'intrinsics_px', 'camera_T_ego'];
const REMEDY = 'See docs/scene-folder.md for the fields.';

/**
 * @typedef {object} Frame
 * @property {string} where for messages
 * @property {string} scene
 * @property {string} token
 * @property {number} timestamp_s
 * @property {number[][]} global_T_ego (4, 4)
 * @property {Map<string, Camera>} cameras by name
 *
 * @typedef {object} Camera
 * @property {number} width_px
 * @property {number} height_px
 * @property {number[][]} intrinsics_px (3, 3)
 * @property {number[][]} camera_T_ego (4, 4)
 * @property {string | null} image path of the image file; null for a lost camera
 */

/**
 * Read and check `scene.json`, and that the folder has every image.
 * @param {import('./folder.js').Folder} folder
 * @param {number} numCameras the largest number of cameras that the bundle accepts
 * @returns {Promise<{folder: object, frames: Frame[]}>}
 */
export async function readScene(folder, numCameras) {
  if (!folder.has(SCENE_NAME)) {
    throw new SceneError(folder.name, `a scene folder, with ${SCENE_NAME} in it`, 'a folder without it', REMEDY);
  }
  const values = parseStrictJson(await folder.read(SCENE_NAME), SCENE_NAME, SceneError);
  const fields = new Fields(values, SCENE_NAME, '', SceneError, REMEDY);
  fields.only(['schema_version', 'scene', 'cameras', 'frames', 'class_mapping']);
  fields.oneOf('schema_version', [1]);
  fields.name('scene');
  const calibrations = fields.has('cameras') ? sceneCameras(fields.object('cameras')) : new Map();
  const records = fields.list('frames', 1);
  const frames = records.map((record, index) => {
    const place = `frames.${index}`;
    return readFrame(new Fields(record, SCENE_NAME, place, SceneError, REMEDY), values.scene, calibrations);
  });
  frames.forEach((frame, index) => {
    checkFrame(frame, numCameras);
    checkTime(frame, frames[index - 1]);
    checkImages(frame, folder);
  });
  return { folder, frames };
}

/**
 * Read the images of a frame.
 * @param {{folder: object}} scene
 * @param {Frame} frame
 * @param {object} jpeg see `decodeImage`
 * @returns {Promise<Map<string, {width: number, height: number, data: Uint8Array} | null>>} by camera, BGR; null if lost
 */
export async function readImages(scene, frame, jpeg) {
  const images = new Map();
  for (const [name, camera] of frame.cameras) {
    const image =
      camera.image === null
        ? null
        : decodeImage(await readFile(scene.folder, camera.image), camera.image, camera, jpeg);
    images.set(name, image);
  }
  return images;
}

async function readFile(folder, path) {
  try {
    return await folder.read(path);
  } catch (error) {
    throw new SceneError(path, 'a file that can be read', error.message, 'Give the folder again.');
  }
}

function sceneCameras(cameras) {
  return new Map(
    cameras.names.map((name) => {
      const camera = cameras.object(name);
      camera.only(CALIBRATION);
      return [name, calibration(camera, CALIBRATION)];
    }),
  );
}

function readFrame(fields, scene, calibrations) {
  fields.only(['timestamp_s', 'token', 'scene', 'global_T_ego', 'cameras', 'boxes', 'maps']);
  const cameras = fields.object('cameras');
  const names = new Set([...calibrations.keys(), ...cameras.names]);
  return {
    where: `${SCENE_NAME}, frame ${fields.place.split('.')[1]}`,
    scene: fields.has('scene') ? fields.name('scene') : scene,
    token: fields.has('token') ? fields.name('token') : '',
    timestamp_s: fields.number('timestamp_s'),
    global_T_ego: fields.matrix('global_T_ego', 4, 4),
    cameras: new Map([...names].map((name) => [name, readCamera(cameras, name, calibrations.get(name))])),
  };
}

/** Return a camera in a frame. Each field is the frame's own, or else the scene's. Without an entry, it is lost. */
function readCamera(cameras, name, ofScene) {
  checkName(cameras, name);
  if (!cameras.has(name)) return { ...ofScene, image: null };
  const camera = cameras.object(name);
  camera.only(['image', ...CALIBRATION]);
  const own = CALIBRATION.filter((field) => camera.has(field));
  const result = { ...ofScene, ...calibration(camera, own) };
  for (const field of CALIBRATION) {
    if (result[field] === undefined) camera.refuse(field, `a value here or in cameras.${name}`, undefined);
  }
  const path = camera.check(
    'image',
    'the path of an image, or null',
    (value) => value === null || typeof value === 'string',
  );
  const image = path === null ? null : normalised(path);
  if (image === undefined) camera.refuse('image', 'a path inside the scene folder', path);
  return { ...result, image };
}

function checkName(cameras, name) {
  if (/\p{Cc}/u.test(name)) cameras.refuse(name, 'a name without control characters', name);
}

function calibration(fields, names) {
  const read = {
    width_px: () => fields.integer('width_px', 1, 10 ** 9),
    height_px: () => fields.integer('height_px', 1, 10 ** 9),
    intrinsics_px: () => fields.matrix('intrinsics_px', 3, 3),
    camera_T_ego: () => fields.matrix('camera_T_ego', 4, 4),
  };
  return Object.fromEntries(names.map((name) => [name, read[name]()]));
}

function checkTime(frame, last) {
  if (last?.scene === frame.scene && frame.timestamp_s <= last.timestamp_s) {
    const expected = `later than ${last.timestamp_s} of the frame before`;
    throw new SceneError(`${frame.where}, timestamp_s`, expected, shown(frame.timestamp_s), 'Sort the frames by time.');
  }
}

function checkImages(frame, folder) {
  for (const [name, camera] of frame.cameras) {
    if (camera.image !== null && !folder.has(camera.image)) {
      const remedy = 'Copy the whole folder. For a lost camera, set the image to null.';
      throw new SceneError(
        `${frame.where}, camera ${name}`,
        `the image ${camera.image} in the folder`,
        'no such file',
        remedy,
      );
    }
  }
}
