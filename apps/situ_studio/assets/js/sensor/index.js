// The page of a sensor: sends camera and microphone to a pipeline, and plays its audio.
import { Clock } from "./clock.js";
import { connectSocket } from "./connection.js";
import { Camera } from "./camera.js";
import { Microphone } from "./microphone.js";
import { Player } from "./player.js";
import { NOTHING, errorText } from "./error_text.js";

const $ = (id) => document.getElementById(id);
const state = { sent: 0, dropped: 0, heard: 0, played: 0, offset: null, running: false };
window.situSensor = state; // for tests and the console
let stop = () => {};

function showStatus(text) {
  $("status").textContent = text;
}

async function listDevices() {
  const devices = await navigator.mediaDevices.enumerateDevices();
  for (const [id, kind] of [
    ["camera", "videoinput"],
    ["microphone", "audioinput"],
  ]) {
    const chosen = $(id).value;
    const found = devices.filter((d) => d.kind === kind);
    const options = found.map((d, i) => new Option(d.label || `${id} ${i + 1}`, d.deviceId));
    $(id).replaceChildren(...options, new Option("none", "none"));
    if (chosen) $(id).value = chosen;
  }
}

const deviceConstraints = (id, more) =>
  $(id).value === "none" ? false : { deviceId: $(id).value || undefined, ...more };

async function startSensor() {
  const video = deviceConstraints("camera", { width: { ideal: 640 }, height: { ideal: 480 } });
  // The page plays the assistant's own voice, which the browser removes from the microphone's signal.
  const audio = deviceConstraints("microphone", { echoCancellation: true });
  if (!video && !audio) return showStatus(NOTHING);
  const stream = await navigator.mediaDevices.getUserMedia({ video, audio });
  await listDevices(); // device names are available after the permission
  const stopTracks = () => stream.getTracks().forEach((track) => track.stop());
  const { socket, credit } = await connectSocket("sensor/socket").catch((error) => {
    stopTracks();
    throw error;
  });
  const parts = [];
  stop = (why) => {
    stop = () => {};
    for (const part of parts) part.stop();
    stopTracks();
    socket.close();
    state.running = false;
    $("start").hidden = false;
    $("stop").hidden = true;
    showStatus(why);
  };
  socket.onclose = ({ reason }) => stop(reason || "The pipeline has ended, or the connection was lost.");
  const clock = new Clock(socket, state);
  const player = new Player(state);
  const pictures = video && new Camera(stream, $("preview"), socket, state);
  parts.push(clock, player);
  if (pictures) parts.push(pictures);
  socket.onmessage = ({ data }) => {
    if (typeof data !== "string") return player.playData(data);
    const message = JSON.parse(data);
    if ("pong" in message) clock.receivePong(message);
    if ("credit" in message) pictures?.addCredit(message.credit);
  };
  pictures?.addCredit(credit);
  if (audio) parts.push(await Microphone.start(stream, socket, state));
  for (const track of stream.getTracks()) track.onended = () => stop("The device was disconnected.");
  state.running = true;
  $("start").hidden = true;
  $("stop").hidden = false;
  showStatus("Running.");
}

if (!navigator.mediaDevices) {
  showStatus(
    "This browser exposes cameras only to secure pages: open the page over https, or on the machine itself.",
  );
  $("start").disabled = true;
} else {
  listDevices();
  navigator.mediaDevices.addEventListener("devicechange", listDevices);
  $("start").onclick = () => startSensor().catch((error) => stop(errorText(error)) ?? showStatus(errorText(error)));
  $("stop").onclick = () => stop("Stopped.");
}
