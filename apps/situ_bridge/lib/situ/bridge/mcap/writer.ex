defmodule Situ.Bridge.Mcap.Writer do
  @moduledoc false
  @behaviour Situ.Bridge.Recorder
  @behaviour Situ.Bridge.Raw.Writer
  # An MCAP file and its channels. The native writer holds the current chunk and receives messages in batches, because
  # each native call switches threads, which costs more than a small message.
  alias Situ.Bridge.Mcap.{Channel, ExtraFields, NativeError, Options}
  alias Situ.Bridge.{Native, RawChannel}
  alias Situ.Error

  # `channels` maps topics to channels with the sequence number of the next message.
  defstruct [:path, :ref, channels: %{}, count: 0, rows: [], row_count: 0, bytes: 0]
  @type t :: %__MODULE__{}

  @impl true
  defdelegate file_options, to: Options
  @impl true
  defdelegate topic_options, to: Options

  @impl true
  @spec create(Path.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def create(path, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, Options.file_options()),
         {:ok, ref} <-
           NativeError.wrap_result(
             Native.mcap_create(path, opts[:profile], opts[:compression], opts[:chunk]),
             path
           ),
         :ok <- write_extras(ref, opts, path),
         do: {:ok, %__MODULE__{path: path, ref: ref}}
  end

  @doc "Appends the attachments and the metadata of the options."
  @spec write_extras(reference(), keyword(), Path.t()) :: :ok | {:error, Error.t()}
  def write_extras(ref, opts, path) do
    with :ok <- write_attachments(ref, opts[:attachments], path),
         do: write_metadata(ref, opts[:metadata], path)
  end

  defp write_attachments(ref, attachments, path) do
    each_ok(attachments, fn attachment ->
      with {:ok, {name, media_type, time, data}} <- load_attachment(attachment),
           do:
             NativeError.wrap_result(Native.mcap_attach(ref, name, media_type, time, data), path)
    end)
  end

  defp load_attachment({name, media_type, time, data} = attachment)
       when is_binary(name) and is_binary(media_type) and is_binary(data) and
              time in 0..0xFFFF_FFFF_FFFF_FFFF,
       do: {:ok, attachment}

  # The time of recording and the time of creation.
  defp load_attachment({_name, _media_type, {log_time, created}, _data} = attachment)
       when is_integer(log_time) and is_integer(created),
       do: {:ok, attachment}

  defp load_attachment(file) when is_binary(file) do
    case File.read(file) do
      {:ok, data} ->
        {:ok, {Path.basename(file), "application/octet-stream", modified_time(file), data}}

      {:error, reason} ->
        {:error,
         Error.new(:io, "cannot read the attachment #{file}", why: :file.format_error(reason))}
    end
  end

  defp load_attachment(other) do
    {:error,
     Error.new(:bad_option, "invalid attachment: #{inspect(other, limit: 5)}",
       fix: "pass a path, or {name, media_type, time, bytes}"
     )}
  end

  # An attachment from a file gets the file's modification time.
  defp modified_time(file) do
    case File.stat(file, time: :posix) do
      {:ok, %{mtime: mtime}} -> max(mtime, 0) * 1_000_000_000
      _ -> 0
    end
  end

  defp write_metadata(ref, records, path) do
    each_ok(records, fn {name, pairs} ->
      pairs = for {key, value} <- pairs, do: {to_string(key), to_string(value)}
      NativeError.wrap_result(Native.mcap_metadata(ref, to_string(name), pairs), path)
    end)
  end

  defp each_ok(list, fun) do
    Enum.reduce_while(list, :ok, fn item, :ok ->
      case fun.(item) do
        {:ok, _} -> {:cont, :ok}
        error -> {:halt, error}
      end
    end)
  end

  @impl true
  @doc "Appends a message; `opts` (`Options.topic_options/0`) apply to the first message of a topic."
  @spec write(t(), String.t(), Situ.Message.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def write(writer, topic, message, opts) do
    with {:ok, channel, sequence} <- ensure_channel(writer, topic, message.data, opts),
         {:ok, bytes} <- Channel.encode(channel, message.data, message.originating_time),
         {recorded, sent} = ExtraFields.fetch_times(message),
         {:ok, recorded} <- check_time(topic, recorded),
         {:ok, sent} <- check_time(topic, sent) do
      row = {channel.id, rem(sequence, 0x1_0000_0000), recorded, sent, bytes}

      channels = Map.put(writer.channels, topic, {channel, sequence + 1})
      append_row(%{writer | channels: channels}, row)
    end
  end

  # MCAP holds messages of any encoding.
  @impl true
  def refuse_channel(_channel), do: nil

  @impl true
  def add_channel(writer, %RawChannel{} = channel) do
    with {:ok, id} <-
           NativeError.wrap_result(
             Native.mcap_channel(
               writer.ref,
               channel.topic,
               channel.encoding,
               channel.schema,
               channel.metadata
             ),
             writer.path
           ),
         do: {:ok, id, writer}
  end

  @impl true
  def write_row(writer, id, {log_time, publish_time, sequence, bytes}),
    do: append_row(writer, {id, sequence, log_time, publish_time, bytes})

  defp append_row(writer, {_id, _sequence, _log_time, _publish_time, bytes} = row) do
    flush_if_full(%{
      writer
      | count: writer.count + 1,
        rows: [row | writer.rows],
        row_count: writer.row_count + 1,
        bytes: writer.bytes + byte_size(bytes)
    })
  end

  @max_rows 500
  @max_bytes 256 * 1024

  defp flush_if_full(%{row_count: row_count, bytes: bytes} = writer)
       when row_count < @max_rows and bytes < @max_bytes,
       do: {:ok, writer}

  defp flush_if_full(writer), do: flush_rows(writer)

  defp flush_rows(%{rows: []} = writer), do: {:ok, writer}

  defp flush_rows(writer) do
    rows = Enum.reverse(writer.rows)

    with {:ok, _} <- NativeError.wrap_result(Native.mcap_write(writer.ref, rows), writer.path),
         do: {:ok, %{writer | rows: [], row_count: 0, bytes: 0}}
  end

  defp check_time(_topic, time) when time in 0..0xFFFF_FFFF_FFFF_FFFF, do: {:ok, time}

  defp check_time(topic, time),
    do:
      {:error,
       Error.new(:not_writable, "a message of #{topic} is from #{Situ.Time.to_iso8601(time)}",
         why: "MCAP supports times from 1970 to 2554"
       )}

  defp ensure_channel(writer, topic, data, opts) do
    case writer.channels do
      %{^topic => {channel, sequence}} -> {:ok, channel, sequence}
      _ -> add_channel(writer, topic, data, opts)
    end
  end

  defp add_channel(writer, topic, data, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, Options.topic_options()),
         {:ok, channel} <- Channel.new(topic, opts, data),
         encoding = Atom.to_string(channel.encoding),
         {:ok, id} <-
           NativeError.wrap_result(
             Native.mcap_channel(writer.ref, topic, encoding, channel.schema, channel.metadata),
             writer.path
           ),
         do: {:ok, %{channel | id: id}, 0}
  end

  @impl true
  @doc "Passes all messages so far to the operating system as complete chunks."
  def flush(writer) do
    with {:ok, writer} <- flush_rows(writer),
         {:ok, _} <- NativeError.wrap_result(Native.mcap_flush(writer.ref), writer.path),
         do: {:ok, writer}
  end

  @impl true
  @doc "Writes the index and closes the file."
  def finish(writer) do
    with {:ok, writer} <- flush_rows(writer),
         do: NativeError.wrap_result(Native.mcap_finish(writer.ref), writer.path)
  end
end
