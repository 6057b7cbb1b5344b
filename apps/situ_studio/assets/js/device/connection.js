// The connection of a sensor page: it is open once the pipeline has granted credit to send.

// Returns {socket, credit}. `path` is relative to the studio; the first message contains the credit.
export async function connectSocket(path) {
  const socket = new WebSocket(socketAddress(path));
  socket.binaryType = "arraybuffer";
  const { credit } = await new Promise((taken, failed) => {
    socket.onmessage = ({ data }) => typeof data === "string" && taken(JSON.parse(data));
    socket.onclose = ({ reason }) => failed(new Error(reason || "the studio is not responding"));
  });
  return { socket, credit };
}

function socketAddress(path) {
  const url = new URL(path + location.search, document.baseURI);
  url.protocol = url.protocol.replace("http", "ws");
  return url.href;
}
