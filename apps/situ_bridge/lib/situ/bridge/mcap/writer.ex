defmodule Situ.Bridge.Mcap.Writer do
  @moduledoc false
  @behaviour Situ.Bridge.Recorder
  # An MCAP file and its channels, as a value. The native writer holds the current chunk and receives messages in
  # batches: each native call switches threads, which costs more than a small message.
  alias Situ.Bridge.Mcap.{Channel, Extra, Failure, Options}
  alias Situ.Bridge.Native
  alias Situ.Error

  # `channels` maps topics to channels with the sequence number of the next message.
  defstruct [:path, :ref, channels: %{}, count: 0, rows: [], waiting: 0, bytes: 0]
  @type t :: %__MODULE__{}

  @impl true
  defdelegate file_options, to: Options, as: :file
  @impl true
  defdelegate topic_options, to: Options, as: :topic

  @impl true
  @spec create(Path.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def create(path, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, Options.file()),
         {:ok, ref} <-
           Failure.wrap(
             Native.mcap_create(path, opts[:profile], opts[:compression], opts[:chunk]),
             path
           ),
         :ok <- carry(ref, opts, path),
         do: {:ok, %__MODULE__{path: path, ref: ref}}
  end

  @doc "Appends the attachments and the metadata of the options."
  @spec carry(reference(), keyword(), Path.t()) :: :ok | {:error, Error.t()}
  def carry(ref, opts, path) do
    with :ok <- attach(ref, opts[:attachments], path),
         do: describe(ref, opts[:metadata], path)
  end

  defp attach(ref, attachments, path) do
    each(attachments, fn attachment ->
      with {:ok, {name, media_type, time, data}} <- attachment(attachment),
           do: Failure.wrap(Native.mcap_attach(ref, name, media_type, time, data), path)
    end)
  end

  defp attachment({name, media_type, time, data} = attachment)
       when is_binary(name) and is_binary(media_type) and is_binary(data) and
              time in 0..0xFFFF_FFFF_FFFF_FFFF,
       do: {:ok, attachment}

  defp attachment(file) when is_binary(file) do
    case File.read(file) do
      {:ok, data} ->
        {:ok, {Path.basename(file), "application/octet-stream", stamp(file), data}}

      {:error, reason} ->
        {:error,
         Error.new(:io, "cannot read the attachment #{file}", why: :file.format_error(reason))}
    end
  end

  defp attachment(other) do
    {:error,
     Error.new(:bad_option, "invalid attachment: #{inspect(other, limit: 5)}",
       fix: "pass a path, or {name, media_type, time, bytes}"
     )}
  end

  # Attachments from files use the modification time.
  defp stamp(file) do
    case File.stat(file, time: :posix) do
      {:ok, %{mtime: mtime}} -> max(mtime, 0) * 1_000_000_000
      _ -> 0
    end
  end

  defp describe(ref, records, path) do
    each(records, fn {name, pairs} ->
      pairs = for {key, value} <- pairs, do: {to_string(key), to_string(value)}
      Failure.wrap(Native.mcap_metadata(ref, to_string(name), pairs), path)
    end)
  end

  defp each(list, fun) do
    Enum.reduce_while(list, :ok, fn one, :ok ->
      case fun.(one) do
        {:ok, _} -> {:cont, :ok}
        error -> {:halt, error}
      end
    end)
  end

  @impl true
  @doc "Appends a message; `opts` (`Options.topic/0`) apply to the first message of a topic."
  @spec write(t(), String.t(), Situ.Message.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def write(writer, topic, message, opts) do
    with {:ok, channel, sequence} <- channel(writer, topic, message.data, opts),
         {:ok, bytes} <- Channel.encode(channel, message.data, message.originating_time),
         {recorded, sent} = Extra.fetch_times(message),
         {:ok, recorded} <- time(topic, recorded),
         {:ok, sent} <- time(topic, sent) do
      row = {channel.id, rem(sequence, 0x1_0000_0000), recorded, sent, bytes}

      hand_over(%{
        writer
        | channels: Map.put(writer.channels, topic, {channel, sequence + 1}),
          count: writer.count + 1,
          rows: [row | writer.rows],
          waiting: writer.waiting + 1,
          bytes: writer.bytes + byte_size(bytes)
      })
    end
  end

  @most_waiting 500
  @most_bytes 256 * 1024

  defp hand_over(%{waiting: waiting, bytes: bytes} = writer)
       when waiting < @most_waiting and bytes < @most_bytes,
       do: {:ok, writer}

  defp hand_over(writer), do: hand_over_all(writer)

  defp hand_over_all(%{rows: []} = writer), do: {:ok, writer}

  defp hand_over_all(writer) do
    rows = Enum.reverse(writer.rows)

    with {:ok, _} <- Failure.wrap(Native.mcap_write(writer.ref, rows), writer.path),
         do: {:ok, %{writer | rows: [], waiting: 0, bytes: 0}}
  end

  defp time(_topic, time) when time in 0..0xFFFF_FFFF_FFFF_FFFF, do: {:ok, time}

  defp time(topic, time),
    do:
      {:error,
       Error.new(:not_writable, "a message of #{topic} is from #{Situ.Time.to_iso8601(time)}",
         why: "MCAP supports times from 1970 to 2554"
       )}

  defp channel(writer, topic, data, opts) do
    case writer.channels do
      %{^topic => {channel, sequence}} -> {:ok, channel, sequence}
      _ -> add(writer, topic, data, opts)
    end
  end

  defp add(writer, topic, data, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, Options.topic()),
         {:ok, channel} <- Channel.new(topic, opts, data),
         encoding = Atom.to_string(channel.encoding),
         {:ok, id} <-
           Failure.wrap(
             Native.mcap_channel(writer.ref, topic, encoding, channel.schema, channel.metadata),
             writer.path
           ),
         do: {:ok, %{channel | id: id}, 0}
  end

  @impl true
  @doc "Passes all messages so far to the operating system as complete chunks."
  def flush(writer) do
    with {:ok, writer} <- hand_over_all(writer),
         {:ok, _} <- Failure.wrap(Native.mcap_flush(writer.ref), writer.path),
         do: {:ok, writer}
  end

  @impl true
  @doc "Writes the index and closes the file."
  def finish(writer) do
    with {:ok, writer} <- hand_over_all(writer),
         do: Failure.wrap(Native.mcap_finish(writer.ref), writer.path)
  end
end
