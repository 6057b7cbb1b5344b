// Collects the files that a user drops or chooses: each item is a file, or a folder with its files.

/**
 * @typedef {{path: string, file: File}} UploadFile the path begins with the name of the item
 * @typedef {{name: string, files: UploadFile[]}} UploadItem
 */

// Groups chosen files: those of a folder have a relative path.
/**
 * @param {Iterable<File>} files
 * @returns {UploadItem[]}
 */
export const chosenItems = (files) =>
  groupFiles([...files].map((file) => ({ path: file.webkitRelativePath || file.name, file })));

/**
 * @param {UploadFile[]} files
 * @returns {UploadItem[]}
 */
function groupFiles(files) {
  /** @type {Map<string, UploadFile[]>} */
  const items = new Map();
  for (const entry of files) {
    const [name] = entry.path.split("/");
    items.set(name, [...(items.get(name) ?? []), entry]);
  }
  return [...items].map(([name, members]) => ({ name, files: members }));
}

// Reads what was dropped. The browser forgets the entries after the event, so they are taken before anything is read.
// Files that were not dragged from a folder, such as those of a web page, have no entry.
/**
 * @param {DataTransfer} transfer
 * @returns {Promise<UploadItem[]>}
 */
export async function droppedItems(transfer) {
  const dropped = [...transfer.items].map((item) => ({ entry: item.webkitGetAsEntry(), file: item.getAsFile() }));
  const files = await Promise.all(
    dropped.map(({ entry, file }) =>
      entry ? entryFiles(entry, entry.name) : file ? [{ path: file.name, file }] : [],
    ),
  );
  return groupFiles(files.flat());
}

/**
 * @param {FileSystemEntry} entry
 * @param {string} path
 * @returns {Promise<UploadFile[]>}
 */
async function entryFiles(entry, path) {
  if (isFile(entry)) {
    const file = await new Promise((done, failed) => entry.file(done, failed));
    return [{ path, file }];
  }
  const children = await readFolder(/** @type {FileSystemDirectoryEntry} */ (entry));
  const files = await Promise.all(children.map((child) => entryFiles(child, `${path}/${child.name}`)));
  return files.flat();
}

/**
 * @param {FileSystemEntry} entry
 * @returns {entry is FileSystemFileEntry}
 */
const isFile = (entry) => entry.isFile;

// A reader returns some entries at a time, and none at the end.
/** @param {FileSystemDirectoryEntry} folder */
async function readFolder(folder) {
  const reader = folder.createReader();
  /** @type {FileSystemEntry[]} */
  const all = [];
  for (;;) {
    /** @type {FileSystemEntry[]} */
    const some = await new Promise((done, failed) => reader.readEntries(done, failed));
    if (!some.length) return all;
    all.push(...some);
  }
}
