// Recordings in the browser: the plans of an MCAP file as graspd writes it, one call a chunk, without compression.
// See docs/recording.md for what is in it.
import { decode } from "./wire.js";
import { MESSAGES } from "./schema.js";

const MAGIC = [0x89, 0x4d, 0x43, 0x41, 0x50, 0x30, 0x0d, 0x0a];
const CHANNEL = 0x04, MESSAGE = 0x05, CHUNK = 0x06, DATA_END = 0x0f;
const TEXT = new TextDecoder();
// What the page reads of foxglove.RawImage: its pixels.
MESSAGES.RawImage = [[6, "data", "bytes", ""]];

const view = bytes => new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);

// Calls `each` with kind and content of every record; stops at one that is not whole.
function records(bytes, each) {
  const numbers = view(bytes);
  let at = 0;
  while (at + 9 <= bytes.length) {
    const kind = bytes[at], length = Number(numbers.getBigUint64(at + 1, true));
    if (at + 9 + length > bytes.length) return;
    if (each(kind, bytes.subarray(at + 9, at + 9 + length)) === false) return;
    at += 9 + length;
  }
}

function text(bytes, at) {
  const length = view(bytes).getUint32(at, true);
  return [TEXT.decode(bytes.subarray(at + 4, at + 4 + length)), at + 4 + length];
}

const frames = record => (record.plan_grasps || record.plan_multi_hand || { frames: [] }).frames;

// Plans in their order, with the pixels of their frames; throws for what is no recording.
export function plans(file) {
  if (file.length < 8 || MAGIC.some((byte, i) => file[i] !== byte)) throw new Error("expected an MCAP file");
  const topics = new Map(), found = [];
  let pixels = new Map(), sequence = -1;
  const message = data => {
    const head = view(data), topic = topics.get(head.getUint16(0, true)) || "", number = head.getUint32(2, true), content = data.subarray(22);
    if (number !== sequence) { sequence = number; pixels = new Map(); }
    if (/^\/camera\/\d+\/depth$/.test(topic)) pixels.set(topic, decode("RawImage", content).data);
    if (topic !== "/graspd/plan") return;
    const record = decode("PlanRecord", content);
    // Pixels of raw images lie beside the request.
    frames(record).forEach((frame, i) => {
      if (!frame.data.length) frame.data = pixels.get("/camera/" + i + "/depth") || frame.data;
    });
    found.push(record);
  };
  const one = (kind, data) => {
    if (kind === CHANNEL) topics.set(view(data).getUint16(0, true), text(data, 4)[0]);
    else if (kind === MESSAGE) message(data);
    else if (kind === CHUNK) {
      const [compression, at] = text(data, 28);
      if (compression) throw new Error("chunks are compressed with " + compression + "; graspd writes them without");
      records(data.subarray(at + 8), one);
    }
    return kind !== DATA_END;
  };
  records(file.subarray(8), one);
  if (!found.length) throw new Error("there is no plan in this recording");
  return found;
}

// The request of a recorded call: its frames, how they were read, and its tasks.
export function question(record) {
  const { plan_grasps: one, plan_multi_hand: several } = record;
  if (one) return { frames: one.frames, scene_options: one.scene_options, tasks: [{ task_id: "1", hand: one.hand, options: one.options }] };
  if (several) return { frames: several.frames, scene_options: several.scene_options, tasks: several.tasks };
  throw new Error("this call has no request");
}
