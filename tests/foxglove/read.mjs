// Reads a run.mcap as Foxglove does; prints how many messages each topic has, by its type, as JSON.
//
//     node read.mjs RUN.mcap

import { open } from "node:fs/promises";
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";

function check(type, message) {
  const { data, info } = message;
  if (type.endsWith("/OccupancyGrid") && data.length !== info.width * info.height) {
    throw new Error(`a grid of ${info.width} x ${info.height} with ${data.length} cells`);
  }
  if (type.endsWith("/PointCloud2") && data.length !== message.row_step * message.height) {
    throw new Error(`a cloud of ${message.width} points with ${data.length} bytes`);
  }
}

const file = await open(process.argv[2], "r");
const reader = await McapIndexedReader.Initialize({
  readable: new FileHandleReadable(file),
  decompressHandlers: await loadDecompressHandlers(),
});
const text = new TextDecoder();
const types = new Map();
for (const schema of reader.schemasById.values()) {
  const definition = parse(text.decode(schema.data), { ros2: true });
  types.set(schema.id, { name: schema.name, reader: new MessageReader(definition) });
}
const topics = {};
for await (const message of reader.readMessages()) {
  const { topic, schemaId } = reader.channelsById.get(message.channelId);
  const type = types.get(schemaId);
  check(type.name, type.reader.readMessage(message.data));
  topics[topic] ??= { type: type.name, messages: 0 };
  topics[topic].messages += 1;
}
await file.close();
console.log(JSON.stringify({ profile: reader.header.profile, topics }));
