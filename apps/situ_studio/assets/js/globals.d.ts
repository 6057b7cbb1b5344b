// Names that the scripts define for tests and for the browser's console, and names of the audio thread.

interface Window {
  liveSocket?: import("phoenix_live_view").LiveSocket;
  situStudio?: import("./studio.js").Studio;
  situPipeline?: import("./pipeline/graph.js").PipelineGraph;
  situHeadset?: import("./device/page.js").DeviceState & { drawn: number };
  situSensor?: import("./device/page.js").DeviceState & { heard: number; played: number };
}

declare const sampleRate: number;
declare class AudioWorkletProcessor {
  readonly port: MessagePort;
}
declare function registerProcessor(name: string, processor: new () => AudioWorkletProcessor): void;
