defmodule Situ.Bridge.Ros.Bag.MessageReader do
  @moduledoc false
  # Opens a bag for one call, and reads messages at given positions.
  alias Situ.Bridge.Ros.Bag.{Chunk, Record}
  alias Situ.Bridge.Ros.MessageIndex
  alias Situ.Error

  @max_bytes 16 * 1024 * 1024

  @doc "Returns the size of the file in bytes."
  @spec file_size(Path.t()) :: {:ok, non_neg_integer()} | {:error, Error.t()}
  def file_size(path) do
    case File.stat(path) do
      {:ok, %{size: size}} -> {:ok, size}
      {:error, reason} -> {:error, build_error({:io, reason}, path)}
    end
  end

  # Any process may call a reader, but a raw file belongs to one process, so the file is opened for each call.
  @doc "Calls `fun` with the opened file. The reasons that `Index.read/2` returns become errors."
  @spec with_file(Path.t(), (:file.fd() -> result)) :: result | {:error, Error.t()}
        when result: term()
  def with_file(path, fun) do
    case :file.open(path, [:read, :raw, :binary]) do
      {:ok, file} ->
        result = fun.(file)
        :file.close(file)

        with {:error, reason} when not is_struct(reason, Error) <- result,
             do: {:error, build_error(reason, path)}

      {:error, reason} ->
        {:error, build_error({:io, reason}, path)}
    end
  end

  defp build_error({:io, reason}, path),
    do: Error.new(:io, "cannot read #{path}", why: to_string(:file.format_error(reason)))

  defp build_error(:not_bag, path),
    do: Error.new(:not_bag, "#{path} is not a bag", why: "it does not begin with #ROSBAG V2.0")

  defp build_error({:version, version}, path),
    do:
      Error.new(:not_bag, "#{path} is a bag of version #{version}",
        why: "only version 2.0 can be read",
        fix: "convert it with `rosbag fix`"
      )

  # Reads the recording times and bytes of as many messages as fit into a batch. A chunk is unpacked once for
  # consecutive messages.
  @spec read_messages(Path.t(), non_neg_integer(), [MessageIndex.row()]) ::
          {:ok, [{MessageIndex.row(), {Situ.Time.t() | nil, binary()}}]} | {:error, Error.t()}
  def read_messages(path, size, positions) do
    with_file(path, fn file ->
      positions
      |> Enum.chunk_by(&elem(&1, 1))
      |> Enum.reduce_while({:ok, [], 0}, fn [{_, at, _} | _] = group, {:ok, messages, bytes} ->
        case Chunk.read(file, at, size) do
          _ when bytes > @max_bytes ->
            {:halt, {:ok, messages, bytes}}

          {:ok, records} ->
            collect_group(records, group, messages, bytes, at)

          {:error, why} ->
            {:halt,
             {:error,
              Error.new(:damaged, "the chunk at byte #{at} of #{path} cannot be read", why: why)}}
        end
      end)
    end)
    |> case do
      {:ok, messages, _} -> {:ok, messages |> Enum.reverse() |> Enum.concat()}
      error -> error
    end
  end

  defp collect_group(records, group, messages, bytes, at) do
    rows = for {_, _, offset} = position <- group, do: {position, parse_record(records, offset)}

    if Enum.any?(rows, &(elem(&1, 1) == nil)),
      do:
        {:halt,
         {:error,
          Error.new(:damaged, "the index of the chunk at byte #{at} does not point to a message")}},
      else:
        {:cont,
         {:ok, [rows | messages],
          bytes + Enum.sum(for {_, {_, data}} <- rows, do: byte_size(data))}}
  end

  defp parse_record(records, offset) when offset < byte_size(records) do
    case Record.take_record(binary_part(records, offset, byte_size(records) - offset)) do
      {:ok, :message, fields, data, _rest} -> {Record.parse_time(fields["time"]), data}
      _ -> nil
    end
  end

  defp parse_record(_records, _offset), do: nil
end
