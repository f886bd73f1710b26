// Protobuf, as far as the protocol needs it: plain objects to bytes and back, by the tables of schema.js.
import { MESSAGES } from "./schema.js";

const VARINT = 0, FIXED64 = 1, BYTES = 2, FIXED32 = 5;
const TEXT = new TextDecoder(), UTF8 = new TextEncoder();

const wireType = type => {
  if (type === "double") return FIXED64;
  if (type === "float") return FIXED32;
  if (["int32", "int64", "uint32", "uint64", "bool"].includes(type) || type.startsWith("enum:")) return VARINT;
  return BYTES;
};

const ZERO = type => {
  if (type === "string") return "";
  if (type === "bytes") return new Uint8Array(0);
  return type === "bool" ? false : 0;
};

// === Reading

class Reader {
  constructor(bytes) {
    this.bytes = bytes;
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    this.at = 0;
  }

  need(count) {
    if (this.at + count > this.bytes.length) throw new Error("a message ends too early");
  }

  // As a number where that is exact, else as a BigInt.
  varint() {
    let low = 0, shift = 0;
    for (; shift < 49; shift += 7) {
      this.need(1);
      const byte = this.bytes[this.at++];
      low += (byte & 0x7f) * 2 ** shift;
      if (byte < 0x80) return low;
    }
    let big = BigInt(low);
    for (; shift < 70; shift += 7) {
      this.need(1);
      const byte = this.bytes[this.at++];
      big |= BigInt(byte & 0x7f) << BigInt(shift);
      if (byte < 0x80) return big <= BigInt(Number.MAX_SAFE_INTEGER) ? Number(big) : big;
    }
    throw new Error("a number is too long");
  }

  chunk() {
    const length = Number(this.varint());
    this.need(length);
    this.at += length;
    return this.bytes.subarray(this.at - length, this.at);
  }

  scalar(type) {
    switch (type) {
      case "double": this.need(8); this.at += 8; return this.view.getFloat64(this.at - 8, true);
      case "float": this.need(4); this.at += 4; return this.view.getFloat32(this.at - 4, true);
      case "bool": return this.varint() !== 0;
      case "string": return TEXT.decode(this.chunk());
      case "bytes": return this.chunk();
      case "uint32": case "uint64": return this.varint();
      default: {
        // Negative numbers come as 64 bits in two's complement.
        const value = this.varint();
        return typeof value === "bigint" ? Number(BigInt.asIntN(64, value)) : value;
      }
    }
  }

  skip(wire) {
    if (wire === VARINT) this.varint();
    else if (wire === FIXED64) { this.need(8); this.at += 8; }
    else if (wire === FIXED32) { this.need(4); this.at += 4; }
    else if (wire === BYTES) this.chunk();
    else throw new Error("a message is damaged");
  }
}

const tables = new Map();
function table(name) {
  if (!tables.has(name)) {
    const fields = MESSAGES[name];
    if (!fields) throw new Error("no message " + name);
    tables.set(name, new Map(fields.map(field => [field[0], field])));
  }
  return tables.get(name);
}

// Numbers of one field that stand together; floats become an array of their own kind.
function packed(bytes, type) {
  if (type === "float") return new Float32Array(bytes.slice().buffer, 0, bytes.length >> 2);
  const reader = new Reader(bytes), list = [];
  while (reader.at < bytes.length) list.push(reader.scalar(type));
  return list;
}

// A message as an object: fields that are unset have their default, and null where being unset means something.
export function decode(name, bytes) {
  const fields = table(name), out = {};
  for (const [, field, type, how] of fields.values()) {
    out[field] = how === "repeated" ? [] : how === "map" ? new Map() : how === "optional" ? null : ZERO(type);
  }
  const reader = new Reader(bytes);
  while (reader.at < bytes.length) {
    const key = Number(reader.varint()), wire = key & 7, known = fields.get(key >>> 3);
    if (!known) { reader.skip(wire); continue; }
    const [, field, type, how] = known;
    if (how === "map") {
      const [, keyType, valueType] = type.split(":"), entry = new Reader(reader.chunk());
      let k = ZERO(keyType), v = ZERO(valueType);
      while (entry.at < entry.bytes.length) {
        const part = Number(entry.varint());
        if (part >>> 3 === 1) k = entry.scalar(keyType);
        else if (part >>> 3 === 2) v = entry.scalar(valueType);
        else entry.skip(part & 7);
      }
      out[field].set(k, v);
    } else if (MESSAGES[type]) {
      const value = decode(type, reader.chunk());
      if (how === "repeated") out[field].push(value); else out[field] = value;
    } else if (how === "repeated") {
      const isPacked = wire === BYTES && wireType(type) !== BYTES;
      if (!isPacked) out[field] = [...out[field], reader.scalar(type)];
      else {
        const more = packed(reader.chunk(), type);
        out[field] = out[field].length ? [...out[field], ...more] : more;
      }
    } else out[field] = reader.scalar(type);
  }
  return out;
}

// === Writing

class Writer {
  constructor() { this.parts = []; this.length = 0; }
  push(bytes) { this.parts.push(bytes); this.length += bytes.length; }

  varint(value) {
    let rest = BigInt.asUintN(64, BigInt(value));
    const bytes = [];
    do {
      const low = Number(rest & 0x7fn);
      rest >>= 7n;
      bytes.push(rest ? low | 0x80 : low);
    } while (rest);
    this.push(Uint8Array.from(bytes));
  }

  chunk(bytes) { this.varint(bytes.length); this.push(bytes); }

  scalar(type, value) {
    if (type === "double" || type === "float") {
      const size = type === "double" ? 8 : 4, view = new DataView(new ArrayBuffer(size));
      if (size === 8) view.setFloat64(0, value, true); else view.setFloat32(0, value, true);
      this.push(new Uint8Array(view.buffer));
    } else if (type === "string") this.chunk(UTF8.encode(value));
    else if (type === "bytes") this.chunk(value);
    else this.varint(type === "bool" ? (value ? 1 : 0) : value);
  }

  bytes() {
    const out = new Uint8Array(this.length);
    let at = 0;
    for (const part of this.parts) { out.set(part, at); at += part.length; }
    return out;
  }
}

// An object as a message; a name that the message does not have is a mistake of ours.
export function encode(name, object) {
  const writer = new Writer(), fields = MESSAGES[name];
  for (const key of Object.keys(object)) {
    if (!fields.some(field => field[1] === key)) throw new Error(name + " has no field " + key);
  }
  for (const [number, field, type, how] of fields) {
    const given = object[field];
    if (given === undefined || given === null) continue;
    if (how === "map") throw new Error("maps are only read");
    const list = how === "repeated" ? given : [given];
    if (how === "repeated" && wireType(type) !== BYTES) {
      if (!list.length) continue;
      const inner = new Writer();
      for (const value of list) inner.scalar(type, value);
      writer.varint(number << 3 | BYTES);
      writer.chunk(inner.bytes());
      continue;
    }
    for (const value of list) {
      writer.varint(number << 3 | wireType(type));
      if (MESSAGES[type]) writer.chunk(encode(type, value)); else writer.scalar(type, value);
    }
  }
  return writer.bytes();
}

// Seconds of a Duration or a Timestamp.
export const seconds = time => time ? Number(time.seconds) + time.nanos * 1e-9 : 0;
