// The connection of a page that is a sensor: open once its pipeline has given leave to send.

// {socket, credit}: `path` is of the studio; what came first says how much may be sent.
export async function connect(path) {
  const socket = new WebSocket(address(path));
  socket.binaryType = "arraybuffer";
  const { credit } = await new Promise((taken, failed) => {
    socket.onmessage = ({ data }) => typeof data === "string" && taken(JSON.parse(data));
    socket.onclose = ({ reason }) => failed(new Error(reason || "the studio does not answer"));
  });
  return { socket, credit };
}

function address(path) {
  const url = new URL(path + location.search, document.baseURI);
  url.protocol = url.protocol.replace("http", "ws");
  return url.href;
}
