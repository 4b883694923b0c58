// What browsers have and TypeScript does not know yet: https://wicg.github.io/file-system-access/
interface FileSystemHandlePermission {
  mode: "read" | "readwrite";
}

interface FileSystemHandle {
  queryPermission(descriptor: FileSystemHandlePermission): Promise<PermissionState>;
  requestPermission(descriptor: FileSystemHandlePermission): Promise<PermissionState>;
}

interface FileSystemDirectoryHandle {
  values(): AsyncIterable<FileSystemFileHandle | FileSystemDirectoryHandle>;
}

interface DataTransferItem {
  getAsFileSystemHandle?(): Promise<FileSystemHandle | null>;
}

interface Window {
  showDirectoryPicker(options?: { id?: string; mode?: "read" | "readwrite" }): Promise<FileSystemDirectoryHandle>;
}
