import assert from 'node:assert/strict';
import test from 'node:test';

import { readScene } from '../lib/scene.js';
import { folderOf } from './fixtures.js';

const POSE = [
  [1, 0, 0, 0],
  [0, 1, 0, 0],
  [0, 0, 1, 0],
  [0, 0, 0, 1],
];
const CAMERA = {
  width_px: 1600,
  height_px: 900,
  intrinsics_px: [
    [1250, 0, 800],
    [0, 1250, 450],
    [0, 0, 1],
  ],
  camera_T_ego: [
    [0, -1, 0, 0],
    [0, 0, -1, 1.5],
    [1, 0, 0, -1.7],
    [0, 0, 0, 1],
  ],
};

const SCENE = {
  schema_version: 1,
  scene: 'drive 1',
  cameras: { front: CAMERA, back: CAMERA },
  frames: [
    { timestamp_s: 1, global_T_ego: POSE, cameras: { front: { image: 'images/1.png' } }, boxes: [], maps: {} },
    {
      timestamp_s: 2,
      token: '2',
      scene: 'drive 2',
      global_T_ego: POSE,
      cameras: {
        back: { image: null },
        front: { image: 'images/1.png', width_px: 1601 },
        side: { image: null, ...CAMERA },
      },
    },
  ],
};

async function readChanged(change, numCameras = 6) {
  const scene = JSON.parse(JSON.stringify(SCENE));
  const changed = change(scene) ?? scene;
  return readScene(folderOf({ 'scene.json': JSON.stringify(changed), 'images/1.png': '' }), numCameras);
}

test('a camera that a frame does not list is lost, and a frame overrides single fields', async () => {
  const { frames } = await readChanged(() => {});
  assert.deepEqual(
    frames.map((frame) => [frame.scene, frame.token]),
    [
      ['drive 1', ''],
      ['drive 2', '2'],
    ],
  );
  assert.deepEqual(
    [...frames[0].cameras].map(([name, camera]) => [name, camera.image]),
    [
      ['front', 'images/1.png'],
      ['back', null],
    ],
  );
  assert.deepEqual([...frames[1].cameras.keys()], ['front', 'back', 'side']);
  assert.equal(frames[1].cameras.get('front').width_px, 1601);
  assert.deepEqual(frames[1].cameras.get('front').intrinsics_px, CAMERA.intrinsics_px);
});

const rotated = (scale) => [
  [scale, 0, 0, 0],
  [0, scale, 0, 0],
  [0, 0, scale, 0],
  [0, 0, 0, 1],
];

const FAULTS = {
  'an unknown field': [
    (s) => {
      s.frames[0].speed = 1;
    },
    /field frames\.0\.speed: expected only the fields/,
  ],
  distortion: [
    (s) => {
      s.cameras.front.distortion = [];
    },
    /field cameras\.front\.distortion/,
  ],
  'no frames': [
    (s) => {
      s.frames = [];
    },
    /field frames: expected a list of at least 1/,
  ],
  'another schema': [
    (s) => {
      s.schema_version = 2;
    },
    /field schema_version: expected 1; found 2/,
  ],
  'a missing image': [
    (s) => {
      s.frames[0].cameras.front.image = 'images/2.png';
    },
    /frame 0, camera front: expected the image images\/2\.png in the folder; found no such file/,
  ],
  'a path out of the folder': [
    (s) => {
      s.frames[0].cameras.front.image = '../1.png';
    },
    /field frames\.0\.cameras\.front\.image: expected a path inside the scene folder/,
  ],
  'no calibration': [
    (s) => {
      delete s.cameras.front;
    },
    /field frames\.0\.cameras\.front\.width_px: expected a value here or in cameras\.front/,
  ],
  'times out of order': [
    (s) => {
      s.frames[1].scene = 'drive 1';
      s.frames[1].timestamp_s = 1;
    },
    /frame 1, timestamp_s: expected later than 1/,
  ],
  milliseconds: [
    (s) => {
      s.frames[0].timestamp_s = 1e12;
    },
    /frame 0, timestamp_s: expected seconds/,
  ],
  'a scaled rotation': [
    (s) => {
      s.frames[0].global_T_ego = rotated(1.1);
    },
    /frame 0, global_T_ego: expected a rotation with determinant 1; found a matrix that is off by 0\.210/,
  ],
  'a mirrored rotation': [
    (s) => {
      s.frames[0].global_T_ego = [[-1, 0, 0, 0], ...POSE.slice(1)];
    },
    /determinant -1\.00/,
  ],
  'a transposed pose': [
    (s) => {
      s.frames[0].global_T_ego = [...POSE.slice(0, 3), [5, 0, 0, 1]];
    },
    /expected the last row 0 0 0 1/,
  ],
  'a huge number': [
    (s) => {
      s.frames[0].global_T_ego[0][3] = 1e10;
    },
    /expected finite numbers, at most 1000000000/,
  ],
  'transposed intrinsics': [
    (s) => {
      s.cameras.back.intrinsics_px = [
        [1250, 0, 0],
        [0, 1250, 0],
        [800, 450, 1],
      ];
    },
    /camera back, intrinsics_px: .* Is the matrix transposed/,
  ],
  'intrinsics of another image': [
    (s) => {
      s.cameras.front.intrinsics_px[0][0] = 100;
    },
    /expected fx of 0\.1 to 60 times the 1600 px/,
  ],
  'a far principal point': [
    (s) => {
      s.cameras.front.intrinsics_px[1][2] = 3000;
    },
    /and cy at most 2 image sizes/,
  ],
  'a name with a control character': [
    (s) => {
      s.scene = 'a\u001bb';
    },
    /field scene: expected text without control characters; found "a\\u001bb"/,
  ],
  'a list instead of a scene': [() => [], /scene\.json: expected an object; found \[\]/],
};

for (const [name, [change, message]] of Object.entries(FAULTS)) {
  test(`${name} is refused`, async () => assert.rejects(readChanged(change), { name: 'SceneError', message }));
}

test('a rotation that was written with three decimals is accepted', async () => {
  await readChanged((scene) => {
    scene.frames[0].global_T_ego = [
      [0.825, -0.565, 0, 0],
      [0.565, 0.825, 0, 0],
      [0, 0, 1, 0],
      [0, 0, 0, 1],
    ];
  });
});

test('more cameras than the bundle has are refused', async () => {
  await assert.rejects(
    readChanged(() => {}, 2),
    /frame 1, cameras: expected 1 to 2, as in the bundle; found 3/,
  );
});

test('a folder without scene.json is refused', async () => {
  await assert.rejects(
    readScene(folderOf({}, 'rig'), 6),
    /^SceneError: rig: expected a scene folder, with scene\.json in it/,
  );
});
