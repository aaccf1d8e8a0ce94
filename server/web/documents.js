// Answers that are one JSON document: Explain, Blame and Structure. 64-bit numbers that JavaScript would
// round arrive as text.

const LARGE = /"(path|placements|total|first)":(\d{16,})/g;

/** Sends the request and returns the bytes of its Payload. */
export async function askBytes(daemon, type, message, options = {}) {
  let bytes = new Uint8Array(0);
  for await (const frame of daemon.request(type, message, options)) {
    if (frame.type !== "Payload") continue;
    if (bytes.length === 0) bytes = new Uint8Array(Number(frame.message.total));
    bytes.set(frame.columns.data, Number(frame.message.offset ?? 0));
  }
  return bytes;
}

/** Sends the request and returns its document. */
export async function askDocument(daemon, type, message, options = {}) {
  return JSON.parse(new TextDecoder().decode(await askBytes(daemon, type, message, options)).replace(LARGE, '"$1":"$2"'));
}

/** Keeps only the latest of several requests: run(signal) is cancelled when the next one begins. */
export function latest(failed) {
  let controller = null;
  return async (run) => {
    controller?.abort(new DOMException("a newer answer is wanted", "AbortError"));
    const mine = controller = new AbortController();
    try {
      await run(mine.signal);
    } catch (error) {
      if (mine === controller) failed(error);
    }
  };
}
