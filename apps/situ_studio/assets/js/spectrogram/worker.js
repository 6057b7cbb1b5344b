// Computes spectra in a separate thread, so that the page stays responsive.
import { computeLevels } from "./fft.js";

self.onmessage = ({ data: { id, samples, count, n } }) => {
  const found = computeLevels(samples, count, n);
  self.postMessage({ id, found }, { transfer: [found.buffer] });
};
