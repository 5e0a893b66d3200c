// A reverse proxy before a server, as nginx with `location /fled/ { proxy_pass http://server/; }`.

import { once } from "node:events";
import { createServer, request } from "node:http";

/** nginx's answer to a body above its limit: no problem document. */
const TOO_LARGE = "<html><head><title>413 Request Entity Too Large</title></head></html>";

export class Proxy {
  /**
   * Serves the server at `to` below `path` and nothing else; refuses bodies above `largest` bytes.
   * `base` is its address with the path; `outside` lists the paths of all other requests, `refused`
   * the lengths of the refused bodies.
   */
  static async start(to, path, largest = Infinity) {
    const proxy = new Proxy();
    Object.assign(proxy, { to, path, largest, outside: [], refused: [] });
    proxy.server = createServer((asked, answer) => proxy.#pass(asked, answer)).listen(0, "127.0.0.1");
    await once(proxy.server, "listening");
    proxy.base = `http://127.0.0.1:${proxy.server.address().port}${path}`;
    return proxy;
  }

  #pass(asked, answer) {
    const { method, headers } = asked;
    if (!asked.url.startsWith(`${this.path}/`)) {
      this.outside.push(asked.url);
      answer.writeHead(404).end();
      return;
    }
    const length = Number(headers["content-length"] ?? 0);
    if (length > this.largest) {
      this.refused.push(length);
      answer.writeHead(413, { "Content-Type": "text/html", Connection: "close" }).end(TOO_LARGE);
      // As nginx, it reads what still comes for a while, so that the answer arrives.
      asked.resume();
      return;
    }
    const url = this.to + asked.url.slice(this.path.length);
    const passed = request(url, { method, headers }, (from) => {
      answer.writeHead(from.statusCode, from.rawHeaders);
      from.pipe(answer);
    });
    passed.on("error", () => answer.destroy());
    answer.on("close", () => passed.destroy());
    asked.pipe(passed);
  }

  async stop() {
    this.server.closeAllConnections();
    this.server.close();
  }
}
