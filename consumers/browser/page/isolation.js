// Threads need a page that is isolated from other origins. If the host does not send the headers for that, a service
// worker adds them, and the page is loaded once more. Without both, the graphs run in one thread.

const TRIED = 'isolation tried';
const PATIENCE_MS = 3000; // some browsers never start the worker, and say nothing

/** Returns whether the page is loaded again. */
export async function isolatePage() {
  if (window.crossOriginIsolated || !window.isSecureContext || !('serviceWorker' in navigator)) return false;
  try {
    if (sessionStorage.getItem(TRIED)) return false;
    await Promise.race([startServiceWorker(), tooLate()]);
    sessionStorage.setItem(TRIED, 'yes');
  } catch {
    return false; // such as in a private window
  }
  window.location.reload();
  return true;
}

async function startServiceWorker() {
  await navigator.serviceWorker.register(new URL('service-worker.js', document.baseURI));
  await navigator.serviceWorker.ready;
}

function tooLate() {
  return new Promise((_, reject) => setTimeout(reject, PATIENCE_MS));
}
