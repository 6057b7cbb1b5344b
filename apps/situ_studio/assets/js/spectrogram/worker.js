// Transforms sound beside the page, which goes on drawing meanwhile.
import { levels } from "./fft.js";

self.onmessage = ({ data: { id, samples, count, n } }) => {
  const found = levels(samples, count, n);
  self.postMessage({ id, found }, [found.buffer]);
};
