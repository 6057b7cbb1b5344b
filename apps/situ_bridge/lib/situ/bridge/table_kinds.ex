defmodule Situ.Bridge.TableKinds do
  @moduledoc false
  # The kinds of files with one stream (tables), for the list of all kinds (`Situ.Recording.Formats.list_kinds/0`).
  alias Situ.Bridge.TableRecording
  alias Situ.Recording.FileKind

  @doc "Returns the kinds."
  @spec kinds() :: [FileKind.t()]
  def kinds do
    [
      table(:arrow, "Arrow", [".arrow", ".arrows", ".feather"], [".arrow"], TableRecording),
      %{
        table(:parquet, "Parquet", [".parquet"], [".parquet"], TableRecording)
        | signatures: [{0, "PAR1"}]
      },
      table(:json_lines, "JSON lines", [".jsonl"], [".jsonl"], TableRecording),
      table(:message_pack, "MessagePack", [".msgpack"], [".msgpack"], TableRecording),
      # `Situ.Store.Csv` opens any CSV file; the layout that Situ writes is imported as a table.
      table(:csv, "CSV and TSV", [".csv"], [".csv"], nil),
      table(:json, "JSON", [".json"], [".json"], nil),
      # Only the user knows the type of its messages.
      table(:protobuf, "Protobuf messages", [".pb"], [".pb"], nil)
    ]
  end

  defp table(name, title, extensions, export, open) do
    %FileKind{
      name: name,
      title: title,
      extensions: extensions,
      export: export,
      open: open,
      import: true
    }
  end
end
