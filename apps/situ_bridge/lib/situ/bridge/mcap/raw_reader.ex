defmodule Situ.Bridge.Mcap.RawReader do
  @moduledoc false
  # Reads the messages of an MCAP file without decoding them.
  @behaviour Situ.Bridge.Raw.Reader
  alias Situ.Bridge.Mcap.NativeError
  alias Situ.Bridge.{Native, RawChannel}

  # A merge holds such a batch of every channel.
  @max_bytes 4 * 1024 * 1024

  @impl true
  def list_channels(state) do
    {_profile, _library, channels, schemas, _attachments, _metadata, _damage} =
      Native.mcap_info(state.ref)

    schemas = Map.new(schemas, fn {id, name, encoding, data} -> {id, {name, encoding, data}} end)

    Situ.Error.map_ok(channels, fn {id, topic, encoding, schema, metadata, _count} ->
      with {:ok, span} <-
             NativeError.wrap_result(Native.mcap_span(state.ref, id, :log), state.path) do
        {_first, _last, count} = span || {nil, nil, 0}

        {:ok,
         %RawChannel{
           id: id,
           topic: topic,
           stream: state.channels[id].name,
           encoding: encoding,
           schema: schemas[schema],
           metadata: metadata,
           count: count
         }}
      end
    end)
  end

  @impl true
  def seek(state, channel, time),
    do: NativeError.wrap_result(Native.mcap_seek(state.ref, channel.id, :log, time), state.path)

  @impl true
  def read(state, channel, ordinal, limit) do
    query = {{channel.id, :log}, ordinal, :unbounded, {limit, @max_bytes}, {false, false}}

    with {:ok, {rows, next}} <-
           NativeError.wrap_result(Native.mcap_read(state.ref, query), state.path) do
      {:ok,
       for(
         {_time, log_time, publish_time, sequence, bytes} <- rows,
         do: {log_time, publish_time, sequence, bytes}
       ), next}
    end
  end

  @impl true
  def read_extras(state) do
    attachments =
      Situ.Error.map_ok(state.info.attachments, fn {name, media_type, time, offset, _size} ->
        with {:ok, bytes} <-
               NativeError.wrap_result(Native.mcap_attachment(state.ref, offset), state.path),
             do: {:ok, {name, media_type, attachment_times(state.path, offset, time), bytes}}
      end)

    with {:ok, attachments} <- attachments, do: {:ok, attachments, state.info.metadata}
  end

  # The record begins with its kind, its length, and the times of recording and creation.
  defp attachment_times(path, offset, time) do
    with {:ok, file} <- :file.open(path, [:read, :raw, :binary]),
         result = :file.pread(file, offset + 17, 8),
         :ok <- :file.close(file),
         {:ok, <<created::little-64>>} when created != time <- result do
      {time, created}
    else
      _ -> time
    end
  end
end
