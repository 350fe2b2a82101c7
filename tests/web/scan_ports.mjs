// Connects to every tcp port of an address, and tells those that are open, as JSON.
// usage: node scan_ports.mjs ADDRESS
import { connect } from "node:net";

const [address] = process.argv.slice(2);
const open = [];
let next = 1;
const one = (port) =>
  new Promise((done) => {
    const socket = connect({ host: address, port, timeout: 3000 });
    const end = (is_open) => {
      if (is_open) open.push(port);
      socket.destroy();
      done();
    };
    socket.once("connect", () => end(true));
    socket.once("error", () => end(false));
    socket.once("timeout", () => end(false));
  });
await Promise.all(
  Array.from({ length: 256 }, async () => {
    while (next <= 65535) await one(next++);
  }),
);
console.log(JSON.stringify(open));
