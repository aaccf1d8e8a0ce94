// Runs one request and gathers its columns into whole pictures. Rows arrive in any order.

/** Returns {columns, started, done}; calls onRows(columns, first, end) for rows that have come. */
export async function traceQuery(daemon, message, count, { signal, onRows = () => {} } = {}) {
  const columns = {};
  let started = null, done = null;
  for await (const frame of daemon.request("Query", message, { signal })) {
    if (frame.type === "Started") started = frame.message;
    if (frame.type === "Done") done = frame.message;
    if (frame.type !== "Chunk") continue;
    const first = Number(frame.message.first_ray), rows = frame.message.count;
    for (const [name, values] of Object.entries(frame.columns)) {
      const width = values.length / rows;
      columns[name] ??= new values.constructor(count * width);
      if (values.length) columns[name].set(values, first * width);
    }
    onRows(columns, first, first + rows);
  }
  return { columns, started, done };
}

/**
 * Runs a request for a lit picture of linear values, four floats per pixel; calls onPass(linear, samples, stops)
 * for each whole picture, with the stops of exposure auto, and onProgress(message).
 */
export async function traceLit(daemon, message, count, { signal, onPass = () => {}, onProgress = () => {} } = {}) {
  let started = null, done = null, bytes = null;
  for await (const { type, message: news, columns } of daemon.request("Render", message, { signal })) {
    if (type === "Started") started = news;
    if (type === "Done") done = news;
    if (type === "Progress") onProgress(news);
    if (type !== "Payload") continue;
    const first = Number(news.offset ?? 0), { data } = columns;
    if (first === 0) bytes = new Uint8Array(16 * count);
    bytes.set(data, first);
    if (first + data.length === bytes.length) onPass(new Float32Array(bytes.buffer), news.samples ?? 0, news.exposure ?? 0);
  }
  return { columns: {}, started, done };
}

/** As traceQuery, for a picture of four bytes per pixel. */
export const traceRender = (daemon, message, count, options) => traceRaw(daemon, "Render", message, count, options);

/**
 * As traceQuery, for a heat map of a measured metric. `normals` is a query for the surface behind it, which runs
 * before: it would take time from what is measured.
 */
export async function traceHeat(daemon, message, normals, count, { signal, onRows = () => {} } = {}) {
  const shape = await traceQuery(daemon, normals, count, { signal });
  const { columns: { rgba }, started, done } = await traceRaw(daemon, "Heatmap", message, count, { signal });
  const columns = { ...shape.columns, [message.metric]: new (message.other ? Int32Array : Uint32Array)(rgba.buffer) };
  onRows(columns, 0, count);
  return { columns, started, done };
}

async function traceRaw(daemon, type, message, count, { signal, onRows = () => {} } = {}) {
  const columns = { rgba: new Uint8Array(4 * count) };
  let started = null, done = null;
  for await (const frame of daemon.request(type, { ...message, encode: "raw" }, { signal })) {
    if (frame.type === "Started") started = frame.message;
    if (frame.type === "Done") done = frame.message;
    if (frame.type !== "Payload") continue;
    const first = Number(frame.message.offset), { data } = frame.columns;
    columns.rgba.set(data, first);
    onRows(columns, Math.floor(first / 4), Math.floor((first + data.length) / 4));
  }
  return { columns, started, done };
}
