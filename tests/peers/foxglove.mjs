// Foxglove's own client library (the one that its open viewers are built on) at the live view of a server: reads the
// channels, subscribes to all, decodes every message with protobufjs by the schema that the server sends, and compares
// the poses with what the command line printed as JSON. Arguments: the live view's address, a file with that JSON, which
// is written once this has said "looking".
import { existsSync, readFileSync } from "node:fs";
import { createRequire } from "node:module";

const require = createRequire(`${process.env.PEER_MODULES}/`);
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const { WebSocket } = require("ws");
const protobuf = require("protobufjs");
require("protobufjs/ext/descriptor");

const [address, answer] = process.argv.slice(2);
const subprotocols = [process.env.PEER_SUBPROTOCOL ?? FoxgloveClient.SUPPORTED_SUBPROTOCOL];
const client = new FoxgloveClient({ ws: new WebSocket(address, subprotocols) });
const channels = new Map();
const bySubscription = new Map();
const messages = new Map();
const fail = (why) => {
  console.error(why);
  process.exit(1);
};
setTimeout(() => fail(`too late; seen: ${[...messages.keys()]}`), 90_000);

client.on("error", (error) => fail(error));
client.on("status", (status) => fail(`the server says ${status.message}`));
client.on("close", (event) => fail(`closed: ${event.code}`));
client.on("serverInfo", (info) => console.log(`server: ${info.name}`));
client.on("advertise", (all) => {
  for (const channel of all) {
    const set = protobuf.util.newBuffer(protobuf.util.base64.length(channel.schema));
    protobuf.util.base64.decode(channel.schema, set, 0);
    const type = protobuf.Root.fromDescriptor(set).lookupType(channel.schemaName);
    channels.set(channel.id, { ...channel, type });
    bySubscription.set(client.subscribe(channel.id), channel.id);
  }
  console.log("looking");
});
client.on("unadvertise", (ids) => ids.forEach((id) => messages.delete(channels.get(id).topic)));
client.on("message", ({ subscriptionId, timestamp, data }) => {
  const channel = channels.get(bySubscription.get(subscriptionId));
  const decoded = channel.type.decode(new Uint8Array(data.buffer, data.byteOffset, data.byteLength));
  messages.set(channel.topic, { timestamp, message: channel.type.toObject(decoded, { defaults: true }) });
});

const wanted = ["/camera/0/depth", "/camera/0/calibration", "/camera/0/points", "/grasps/poses", "/grasps/scene", "/graspd/stats", "/graspd/plan"];
const checking = setInterval(() => {
  if (!wanted.every((topic) => messages.has(topic)) || !existsSync(answer)) return;
  clearInterval(checking);
  const text = readFileSync(answer, "utf8");
  const seen = messages.get("/grasps/poses").message.poses.map(({ position: p }) => [p.x, p.y, p.z]);
  if (seen.length === 0) fail("no poses");
  // Every coordinate of ours is one that the command line has printed.
  const printed = new Set(text.match(/-?\d+(\.\d+)?(e-?\d+)?/g).map(Number));
  for (const pose of seen) {
    for (const value of pose) if (!printed.has(value)) fail(`${value} is not in the answer`);
  }
  const { width, height, step, encoding, data } = messages.get("/camera/0/depth").message;
  const bytes = { "16UC1": 2, "32FC1": 4 }[encoding];
  if (step !== width * bytes || data.length !== step * height) fail(`depth: ${data.length} bytes of ${width} × ${height}`);
  console.log(`agree: ${seen.length} grasps on ${messages.size} topics`);
  process.exit(0);
}, 100);
