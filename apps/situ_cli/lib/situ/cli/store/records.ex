defmodule Situ.CLI.Store.Records do
  @moduledoc false
  # Writes the messages of a stream as records: CSV, JSON, JSON lines, MessagePack.
  alias Situ.Bridge.Format
  alias Situ.Bridge.Format.Csv
  alias Situ.CLI.Store.OutputFile

  @doc """
  Writes the parts of a stream (`Situ.Store.columns/3`) into a file, or to standard output (`"-"`). `progress` receives
  the number of messages so far. Returns the number of messages.
  """
  @spec save_parts(Format.name(), Enumerable.t(), Path.t(), (non_neg_integer() -> term())) ::
          non_neg_integer()
  def save_parts(format, parts, file, progress) do
    case format == :csv && Csv.Table.collect_columns(parts) do
      columns when is_list(columns) -> save_table(columns, parts, file, progress)
      _plain_numbers -> save_records(format, parts, file, progress)
    end
  end

  defp save_table(columns, parts, file, progress) do
    out = OutputFile.open_output(file)
    OutputFile.write_bytes(out, Csv.Table.encode_heading(columns))

    count =
      Enum.reduce(parts, 0, fn messages, count ->
        OutputFile.write_bytes(out, Csv.Table.encode_rows(messages, columns))
        progress.(count + length(messages))
        count + length(messages)
      end)

    OutputFile.close_output(out)
    count
  end

  defp save_records(format, parts, file, progress) do
    out = OutputFile.open_output(file)

    position =
      Enum.reduce(parts, 0, fn part, position ->
        {records, position} = encode_records(format, part, position, out)
        OutputFile.write_bytes(out, records)
        progress.(Format.record_count(position))
        position
      end)

    OutputFile.write_bytes(out, Format.fetch_module!(format).finish(position))
    OutputFile.close_output(out)
    Format.record_count(position)
  end

  # A record that cannot be encoded stops the export, and the incomplete file is deleted.
  defp encode_records(format, part, position, out) do
    Format.encode_records(format, part, position)
  rescue
    error in Situ.Error ->
      OutputFile.discard_output(out)
      reraise error, __STACKTRACE__
  end
end
