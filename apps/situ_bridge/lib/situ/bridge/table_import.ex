defmodule Situ.Bridge.TableImport do
  @moduledoc false
  # Imports files of one stream each (JSON, JSON lines, CSV, MessagePack, Parquet, Arrow, Protobuf) as a recording:
  # a new store with one stream per file. The store gets its name only when it is complete; if an error occurs,
  # nothing of it is left on disk.
  alias Situ.Bridge
  alias Situ.{Error, Message}
  alias Situ.Store.{Draft, Writer}

  @batch 1_000

  @type format :: :json | :json_lines | :csv | :message_pack | :parquet | :arrow | :protobuf
  @typedoc "A table. Protobuf files need the options of `Situ.Bridge.Protobuf.File.messages/2`."
  @type table :: {stream :: String.t(), Path.t(), format() | {:protobuf, keyword()}}

  @doc """
  Creates the next version of the store `out` (`ROOT/NAME`); returns `{:ok, path, %{stream => messages}}`. Options:
  `progress:`, a function that receives the number of messages written so far; `notice:`, a function that receives a
  sentence about skipped columns or rows of a table (by default these are logged). Errors: the errors of the formats,
  and `:not_increasing` if the times in a file do not increase.
  """
  @spec import([table()], Path.t(), keyword()) ::
          {:ok, Path.t(), %{String.t() => non_neg_integer()}} | {:error, Error.t()}
  def import(tables, out, opts \\ []) do
    progress = opts[:progress] || fn _written -> :ok end
    counts = :atomics.new(max(length(tables), 1), [])

    result =
      Draft.build_store({Path.basename(out), Path.dirname(out)}, [], fn writer ->
        tables
        |> Enum.with_index(1)
        |> Enum.reduce_while(:ok, fn {table, index}, :ok ->
          report = fn id -> progress.(:atomics.add_get(counts, index, id)) end

          case write_table(writer, table, report, opts[:notice]) do
            :ok -> {:cont, :ok}
            error -> {:halt, error}
          end
        end)
      end)

    with {:ok, path} <- result do
      names = tables |> Enum.map(&elem(&1, 0)) |> Enum.with_index(1)
      {:ok, path, Map.new(names, fn {name, index} -> {name, :atomics.get(counts, index)} end)}
    end
  end

  defp write_table(writer, {name, path, format}, report, notice) do
    # The first pass determines the type; it discards the notices, which the second pass repeats.
    type = value_type(path, stream_rows(path, format, fn _sentence -> :ok end))

    with {:ok, stream} <- Writer.stream(writer, name, type: type) do
      path
      |> stream_rows(format, notice)
      |> Stream.with_index(1)
      |> Stream.chunk_every(@batch)
      |> Enum.reduce_while({:ok, stream, nil}, fn batch, {:ok, stream, _last} ->
        case Writer.append(stream, Enum.map(batch, &build_message/1)) do
          {:ok, stream} ->
            report.(length(batch))
            {{last, _}, _} = List.last(batch)
            {:cont, {:ok, stream, last}}

          error ->
            {:halt, error}
        end
      end)
      |> close_stream()
    end
  rescue
    error in Error -> {:error, error}
  end

  defp close_stream({:ok, _stream, nil}), do: :ok

  defp close_stream({:ok, stream, last}) do
    with {:ok, _} <- Writer.close_stream(stream, last), do: :ok
  end

  defp close_stream(error), do: error

  defp build_message({{time, value}, id}),
    do: %Message{data: value, originating_time: time, creation_time: time, sequence_id: id}

  defp stream_rows(path, :parquet, notice), do: Bridge.Parquet.messages(path, notice: notice)
  defp stream_rows(path, :arrow, notice), do: Bridge.Arrow.messages(path, notice: notice)

  defp stream_rows(path, {:protobuf, opts}, _notice),
    do: Bridge.Protobuf.File.messages(path, opts)

  defp stream_rows(path, format, _notice), do: Bridge.File.messages(path, format)

  @doc "Returns the times and values of a table. `notice` receives a sentence for each part that is skipped."
  @spec read_table(Path.t(), (String.t() -> term())) :: Enumerable.t()
  def read_table(path, notice), do: stream_rows(path, detect_format(path), notice)

  # Returns the common type of all values, or `:any` for a pipe, because a pipe can be read only once.
  defp value_type(path, messages) do
    if File.regular?(path) do
      messages
      |> Enum.reduce_while(nil, fn {_time, value}, known ->
        case common_type(known, value_kind(value)) do
          :any -> {:halt, :any}
          kind -> {:cont, kind}
        end
      end)
      |> Kernel.||(:any)
    else
      :any
    end
  end

  defp value_kind(value) when is_boolean(value), do: :boolean
  defp value_kind(value) when is_integer(value), do: :integer
  defp value_kind(value) when is_float(value), do: :float
  defp value_kind(value) when is_binary(value), do: :string
  defp value_kind(value) when is_map(value), do: :map
  defp value_kind(_value), do: :any

  defp common_type(nil, kind), do: kind
  defp common_type(kind, kind), do: kind

  defp common_type(a, b) when a in [:integer, :float, :number] and b in [:integer, :float],
    do: :number

  defp common_type(_a, _b), do: :any

  @doc """
  Returns the format of a file, or `nil` if it is not a table. The format is determined by the extension, and for CSV
  and JSON, which are common extensions, also by the first bytes.
  """
  @spec detect_format(Path.t()) :: format() | nil
  def detect_format(path) do
    case path |> Path.extname() |> String.downcase() do
      ".parquet" -> :parquet
      ending when ending in [".arrow", ".arrows", ".feather"] -> :arrow
      ".pb" -> :protobuf
      ".jsonl" -> :json_lines
      ".msgpack" -> :message_pack
      ".csv" -> if(first_bytes(path) =~ ~r/\A"?_OriginatingTime_/, do: :csv)
      ".json" -> if(first_bytes(path) =~ ~r/\A\s*\[\s*\{\s*"originatingTime"/, do: :json)
      _ -> nil
    end
  end

  defp first_bytes(path) do
    with {:ok, file} <- :file.open(path, [:read, :raw, :binary]) do
      result = :file.read(file, 100)
      :ok = :file.close(file)

      with {:ok, bytes} <- result, true <- String.printable?(bytes) do
        bytes
      else
        _ -> ""
      end
    else
      {:error, _} -> ""
    end
  end

  @doc "Returns the default stream name of a table: the name of the file."
  @spec stream_name(Path.t()) :: String.t()
  def stream_name(path), do: path |> Path.basename() |> Path.rootname()

  @doc "Returns whether a path is a table, which is opened by importing it."
  @spec table?(Path.t()) :: boolean()
  def table?(path), do: File.regular?(path) and detect_format(path) != nil
end
