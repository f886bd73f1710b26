// gRPC-web: calls of the server that the page came from, one answer or many.
import { decode, encode } from "./wire.js";

const TRAILERS = 0x80;
export const CODES = ["OK", "CANCELLED", "UNKNOWN", "INVALID_ARGUMENT", "DEADLINE_EXCEEDED", "NOT_FOUND", "ALREADY_EXISTS",
  "PERMISSION_DENIED", "RESOURCE_EXHAUSTED", "FAILED_PRECONDITION", "ABORTED", "OUT_OF_RANGE", "UNIMPLEMENTED", "INTERNAL",
  "UNAVAILABLE", "DATA_LOSS", "UNAUTHENTICATED"];

// How a call failed: the code's name and the server's words.
export class CallError extends Error {
  constructor(code, message) {
    super(message || code);
    this.code = code;
  }
}

// The token lives as long as the tab, and nowhere else than in it.
const KEY = "graspd-token";
export const token = {
  get: () => sessionStorage.getItem(KEY) || "",
  set: text => text ? sessionStorage.setItem(KEY, text) : sessionStorage.removeItem(KEY),
  header: () => token.get() ? { authorization: "Bearer " + token.get() } : {},
};

function check(code, message) {
  if (code === null || code === undefined) return;
  const number = Number(code);
  let words = message || "";
  try { words = decodeURIComponent(words); } catch { /* As it came. */ }
  if (number !== 0) throw new CallError(CODES[number] || "UNKNOWN", words);
}

// Calls `each` with every message of the answer, as it comes.
export async function stream(method, [requestType, responseType], request, each, { signal, timeoutSeconds } = {}) {
  const message = encode(requestType, request), body = new Uint8Array(5 + message.length);
  new DataView(body.buffer).setUint32(1, message.length);
  body.set(message, 5);
  const headers = { "content-type": "application/grpc-web+proto", accept: "application/grpc-web+proto", "x-grpc-web": "1", ...token.header() };
  if (timeoutSeconds) headers["grpc-timeout"] = Math.round(timeoutSeconds * 1000) + "m";
  let response;
  try {
    response = await fetch("/graspd.v1." + method, { method: "POST", headers, body, signal });
  } catch (error) {
    if (error.name === "AbortError") throw new CallError("CANCELLED", "stopped");
    throw new CallError("UNAVAILABLE", "the server does not answer");
  }
  if (!response.ok) throw new CallError("UNAVAILABLE", "HTTP " + response.status + ": " + (await response.text()).trim());
  check(response.headers.get("grpc-status"), response.headers.get("grpc-message"));
  const reader = response.body.getReader();
  let held = new Uint8Array(0), ended = response.headers.has("grpc-status");
  for (;;) {
    let piece;
    try {
      piece = await reader.read();
    } catch (error) {
      throw error.name === "AbortError" ? new CallError("CANCELLED", "stopped") : new CallError("UNAVAILABLE", "the connection broke");
    }
    if (piece.done) break;
    const joined = new Uint8Array(held.length + piece.value.length);
    joined.set(held);
    joined.set(piece.value, held.length);
    held = joined;
    while (held.length >= 5) {
      const length = new DataView(held.buffer, held.byteOffset).getUint32(1);
      if (held.length < 5 + length) break;
      const data = held.subarray(5, 5 + length), isTrailers = held[0] & TRAILERS;
      held = held.slice(5 + length);
      if (!isTrailers) { each(decode(responseType, data)); continue; }
      const trailers = new Map(new TextDecoder().decode(data).split("\r\n").filter(line => line.includes(":"))
        .map(line => [line.slice(0, line.indexOf(":")).trim().toLowerCase(), line.slice(line.indexOf(":") + 1).trim()]));
      ended = trailers.has("grpc-status");
      check(trailers.get("grpc-status"), trailers.get("grpc-message"));
    }
  }
  if (!ended) throw new CallError("UNAVAILABLE", "the answer broke off");
}

// The one message of the answer.
export async function call(method, types, request, options) {
  let answer = null;
  await stream(method, types, request, message => { answer = message; }, options);
  if (!answer) throw new CallError("INTERNAL", "an empty answer");
  return answer;
}

export const listHands = request => call("HandService/ListHands", ["ListHandsRequest", "ListHandsResponse"], request);
export const handGeometry = name => call("HandService/GetHandGeometry", ["GetHandGeometryRequest", "GetHandGeometryResponse"], { name });
export const serverInfo = () => call("InfoService/GetServerInfo", ["GetServerInfoRequest", "GetServerInfoResponse"], {});
export const readScene = (request, options) => call("PlannerService/ReadScene", ["ReadSceneRequest", "ReadSceneResponse"], request, options);
export const planHands = (request, each, options) =>
  stream("PlannerService/PlanMultiHand", ["PlanMultiHandRequest", "PlanMultiHandResponse"], request, each, options);
