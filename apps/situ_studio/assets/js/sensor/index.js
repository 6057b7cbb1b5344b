// The page that is a sensor: camera and microphone to a pipeline, sound from it.
import { Clock } from "./clock.js";
import { connect } from "./connection.js";
import { Pictures } from "./pictures.js";
import { Sound } from "./sound.js";
import { Player } from "./player.js";
import { NOTHING, trouble } from "./trouble.js";

const $ = (id) => document.getElementById(id);
const state = { sent: 0, dropped: 0, heard: 0, played: 0, offset: null, running: false };
window.situSensor = state; // for tests and the console
let stop = () => {};

function say(text) {
  $("status").textContent = text;
}

async function list() {
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

const wanted = (id, more) => ($(id).value === "none" ? false : { deviceId: $(id).value || undefined, ...more });

async function start() {
  const video = wanted("camera", { width: { ideal: 640 }, height: { ideal: 480 } });
  // The assistant's own voice comes out of this page: the browser takes it out of what it hears.
  const audio = wanted("microphone", { echoCancellation: true });
  if (!video && !audio) return say(NOTHING);
  const stream = await navigator.mediaDevices.getUserMedia({ video, audio });
  await list(); // names are told after the permission
  const stopTracks = () => stream.getTracks().forEach((track) => track.stop());
  const { socket, credit } = await connect("sensor/socket").catch((error) => {
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
    say(why);
  };
  socket.onclose = ({ reason }) => stop(reason || "The pipeline has ended, or the connection was lost.");
  const clock = new Clock(socket, state);
  const player = new Player(state);
  const pictures = video && new Pictures(stream, $("preview"), socket, state);
  parts.push(clock, player);
  if (pictures) parts.push(pictures);
  socket.onmessage = ({ data }) => {
    if (typeof data !== "string") return player.take(data);
    const told = JSON.parse(data);
    if ("pong" in told) clock.pong(told);
    if ("credit" in told) pictures?.credit(told.credit);
  };
  pictures?.credit(credit);
  if (audio) parts.push(await Sound.start(stream, socket, state));
  for (const track of stream.getTracks()) track.onended = () => stop("The device is gone.");
  state.running = true;
  $("start").hidden = true;
  $("stop").hidden = false;
  say("Running.");
}

if (!navigator.mediaDevices) {
  say("This browser gives no camera here: open the page over https, or on the machine itself.");
  $("start").disabled = true;
} else {
  list();
  navigator.mediaDevices.addEventListener("devicechange", list);
  $("start").onclick = () => start().catch((error) => stop(trouble(error)) ?? say(trouble(error)));
  $("stop").onclick = () => stop("Stopped.");
}
