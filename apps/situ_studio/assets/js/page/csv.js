// Writes lines of CSV (RFC 4180).

/** @param {string[]} cells */
export const csvLine = (cells) => `${cells.map(quoteCell).join(",")}\r\n`;

const quoteCell = (text) => (/[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
