// Frames as WebSocket messages: "TYPE ID JSON" as text, or with bulk data the header of 32 bytes, the JSON
// and the bulk data as binary. PROTOCOL.md, sections 3 and 7, describes the bytes.
import { MESSAGES } from "./lists.js";

const MAGIC = 0x314e5952;  // "RYN1", little endian
const HEADER_BYTES = 32;
const ALIGNMENT = 64;
const NAMES = new Map(Object.entries(MESSAGES).map(([name, number]) => [number, name]));
const ARRAYS = { u8: Uint8Array, u32: Uint32Array, u64: BigUint64Array, f32: Float32Array };
const DTYPES = ["u8", "u32", "u64", "f32"];

/** Returns the WebSocket message of a frame; `columns` are {name, dtype, width, values}. */
export function encodeFrame(type, id, message = {}, columns = []) {
  if (columns.length === 0) return `${type} ${id} ${JSON.stringify(message)}`;
  const blocks = [];
  let offset = 0;
  for (const { name, dtype, width = 1, values } of columns) {
    const stride = width * ARRAYS[dtype].BYTES_PER_ELEMENT;
    blocks.push({ name, dtype, count: values.byteLength / stride, stride, offset, bytes: values.byteLength });
    offset += Math.ceil(values.byteLength / ALIGNMENT) * ALIGNMENT;
  }
  const json = new TextEncoder().encode(JSON.stringify({ ...message, blocks }));
  const bytes = new Uint8Array(HEADER_BYTES + json.length + offset);
  const header = new DataView(bytes.buffer);
  header.setUint32(0, MAGIC, true);
  header.setUint16(4, MESSAGES[type], true);
  header.setUint32(8, json.length, true);
  header.setUint32(12, blocks.length, true);
  header.setBigUint64(16, BigInt(offset), true);
  header.setBigUint64(24, BigInt(id), true);
  bytes.set(json, HEADER_BYTES);
  columns.forEach(({ values }, i) => bytes.set(
    new Uint8Array(values.buffer, values.byteOffset, values.byteLength),
    HEADER_BYTES + json.length + blocks[i].offset));
  return bytes;
}

/** Returns {type, id, message, columns, bulkBytes}; throws where the message is not a frame. */
export function decodeFrame(data) {
  return typeof data === "string" ? decodeText(data) : decodeBinary(data);
}

function decodeText(text) {
  const match = /^(\w+) (\d+) /.exec(text);
  if (!match) throw new Error("the daemon sent a text that is not a frame");
  return { type: match[1], id: Number(match[2]), message: JSON.parse(text.slice(match[0].length)),
           columns: {}, bulkBytes: 0 };
}

function decodeBinary(buffer) {
  if (buffer.byteLength < HEADER_BYTES) throw new Error("the daemon sent a frame without a header");
  const header = new DataView(buffer);
  const controlBytes = header.getUint32(8, true);
  const bulkBytes = Number(header.getBigUint64(16, true));
  if (header.getUint32(0, true) !== MAGIC ||
      HEADER_BYTES + controlBytes + bulkBytes !== buffer.byteLength) {
    throw new Error("the daemon sent a frame whose lengths are wrong");
  }
  const json = new Uint8Array(buffer, HEADER_BYTES, controlBytes);
  const message = JSON.parse(new TextDecoder().decode(json));
  const columns = {};
  for (const block of message.blocks ?? []) {
    columns[block.name] = decodeBlock(buffer, HEADER_BYTES + controlBytes, bulkBytes, block);
  }
  return { type: NAMES.get(header.getUint16(4, true)) ?? "unknown",
           id: Number(header.getBigUint64(24, true)), message, columns, bulkBytes };
}

function decodeBlock(buffer, bulk, bulkBytes, block) {
  const dtype = typeof block.dtype === "number" ? DTYPES[block.dtype] : block.dtype;
  const Values = ARRAYS[dtype];
  const offset = Number(block.offset);
  const bytes = Number(block.bytes);
  const outside = !(offset >= 0 && bytes >= 0 && offset + bytes <= bulkBytes);
  if (!Values || outside || bytes % Values.BYTES_PER_ELEMENT !== 0) {
    throw new Error("the daemon sent a column that lies outside its frame");
  }
  // A copy, because a typed array must begin at a multiple of its element's size.
  return new Values(buffer.slice(bulk + offset, bulk + offset + bytes));
}
