import { defaultClientConditions, defineConfig } from 'vite';

export default defineConfig({
  base: './', // the page works in any folder of a host
  build: { outDir: 'dist', target: 'es2022', assetsInlineLimit: 0, chunkSizeWarningLimit: 1000 },
  worker: { format: 'es' },
  // onnxruntime-web's module and WASM file stay files of their own: its threads load the module again.
  resolve: { conditions: ['onnxruntime-web-use-extern-wasm', ...defaultClientConditions] },
});
