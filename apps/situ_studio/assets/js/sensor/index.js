// The page of a sensor: sends camera and microphone to a pipeline, and plays its audio.
import { Clock } from "../device/clock.js";
import { connectSocket } from "../device/connection.js";
import { DevicePage } from "../device/page.js";
import { findElement, getElement } from "../page/dom.js";
import { Camera } from "./camera.js";
import { Microphone } from "./microphone.js";
import { Player } from "./player.js";
import { NOTHING, errorText } from "./error_text.js";

const page = new DevicePage({ heard: 0, played: 0 });
const { state } = page;
window.situSensor = state; // for tests and the console

/** @param {string} id */
const getSelect = (id) => getElement(id, HTMLSelectElement);

async function listDevices() {
  const devices = await navigator.mediaDevices.enumerateDevices();
  for (const [id, kind] of [
    ["camera", "videoinput"],
    ["microphone", "audioinput"],
  ]) {
    const chosen = getSelect(id).value;
    const found = devices.filter((d) => d.kind === kind);
    const options = found.map((d, i) => new Option(d.label || `${id} ${i + 1}`, d.deviceId));
    getSelect(id).replaceChildren(...options, new Option("none", "none"));
    if (chosen) getSelect(id).value = chosen;
  }
}

/**
 * @param {string} id
 * @param {MediaTrackConstraints} more
 */
const deviceConstraints = (id, more) =>
  getSelect(id).value === "none" ? false : { deviceId: getSelect(id).value || undefined, ...more };

async function startSensor() {
  const video = deviceConstraints("camera", { width: { ideal: 640 }, height: { ideal: 480 } });
  // The page plays the assistant's own voice, which the browser removes from the microphone's signal.
  const audio = deviceConstraints("microphone", { echoCancellation: true });
  if (!video && !audio) return page.showStatus(NOTHING);
  const stream = await navigator.mediaDevices.getUserMedia({ video, audio });
  page.addPart({ stop: () => stream.getTracks().forEach((track) => track.stop()) });
  await listDevices(); // device names are available after the permission
  const { socket, credit } = await connectSocket("sensor/socket");
  page.watchConnection(socket);
  const clock = page.addPart(new Clock(socket, state));
  const player = page.addPart(new Player(state));
  const pictures = video && page.addPart(new Camera(stream, getElement("preview", HTMLVideoElement), socket, state));
  socket.onmessage = ({ data }) => {
    if (typeof data !== "string") return player.playData(data);
    const message = JSON.parse(data);
    if ("pong" in message) clock.receivePong(message);
    if ("credit" in message && pictures) pictures.addCredit(message.credit);
  };
  if (pictures) pictures.addCredit(credit);
  if (audio) page.addPart(await Microphone.start(stream, socket, state));
  for (const track of stream.getTracks()) track.onended = () => page.stop("The device was disconnected.");
  page.showRunning();
  showRecording();
}

// The start page of the studio names the recording that it has begun for this page.
function showRecording() {
  const recording = new URLSearchParams(location.search).get("recording");
  if (!recording) return;
  const box = getElement("recording");
  findElement(box, "a", HTMLAnchorElement).href = `s/${recording.split("/").map(encodeURIComponent).join("/")}`;
  box.hidden = false;
}

if (!navigator.mediaDevices) {
  page.disable(
    "This browser exposes cameras only to secure pages: open the page over https, or on the machine itself.",
  );
} else {
  listDevices();
  navigator.mediaDevices.addEventListener("devicechange", listDevices);
  page.listenStart(startSensor, errorText);
}
