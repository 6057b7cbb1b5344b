defmodule Situ.Store.VideoCoder do
  @moduledoc false
  # The behaviour of the module that compresses images for recordings and decodes them (`Situ.Media` has it), and the
  # functions that use it. An application lists its module in the environment under `video_coder`.
  #
  # A stream of images that is recorded with `encode:` has the type `Situ.Image`, and its messages are stored as
  # `Situ.VideoPacket`. Reading returns images, unless packets are requested.
  # See docs/adr/0196-recordings-store-images-as-video-packets.md.
  alias Situ.{Error, Message, Recording, VideoPacket}
  alias Situ.Store.{StreamInfo, Undecoded}

  @doc "Parses the value of `encode:`."
  @callback parse_encoding(term()) :: {:ok, term()} | {:error, Error.t()}
  @doc "Adds the component that turns a stream of images into packets."
  @callback encode_stream(Situ.Stream.t(), encoding :: term(), keyword()) :: Situ.Stream.t()
  @doc "Decodes consecutive messages with packets. `ordinal` is the ordinal of the first one."
  @callback decode_messages(Recording.t(), StreamInfo.t(), non_neg_integer(), [Message.t()]) ::
              [Message.t()]
  @doc "Describes the packets of a stream."
  @callback describe_packets(Recording.t(), StreamInfo.t()) ::
              {:ok, Recording.CodedVideo.t()} | {:error, Error.t()}

  # The size of the images of one batch.
  @batch_bytes 16 * 1024 * 1024
  @most_images 256

  @doc "Adds the encoder to a stream that is recorded with `encode:`."
  @spec encode_stream(Situ.Stream.t(), term(), keyword()) :: Situ.Stream.t()
  def encode_stream(stream, encode, component) do
    with {:ok, module} <- fetch_module(), {:ok, encoding} <- module.parse_encoding(encode) do
      module.encode_stream(stream, encoding, component)
    else
      {:error, error} -> raise error
    end
  end

  @doc """
  Decodes messages that were read for a stream of images, and returns at most as many as fit into one batch, with the
  next ordinal. Other messages are returned unchanged, and so are packets if the options request them.
  """
  @spec decode_batch(
          Recording.t(),
          StreamInfo.t(),
          {:ok, [Message.t()], non_neg_integer()},
          tuple()
        ) ::
          {:ok, [Message.t()], non_neg_integer()} | {:error, Error.t()}
  def decode_batch(
        store,
        %{type: Situ.Image} = info,
        {:ok, [%{data: %VideoPacket{} = packet} | _] = messages, next},
        {ordinal, to, opts}
      ) do
    if opts[:packets] || opts[:envelopes],
      do: {:ok, messages, next},
      else: decode_most(store, info, {packet, messages, next}, {ordinal, to, opts})
  end

  def decode_batch(_store, _info, result, _place), do: result

  defp decode_most(store, info, {packet, messages, next}, {ordinal, to, opts}) do
    most = images_per_batch(packet)

    if length(messages) > most do
      opts = Keyword.put(opts, :exact, true)

      with {:ok, messages, next} <-
             store.module.read(store.state, info, ordinal, to, most, opts),
           do: {:ok, decode_messages(store, info, ordinal, messages), next}
    else
      {:ok, decode_messages(store, info, ordinal, messages), next}
    end
  end

  defp images_per_batch(%{width: width, height: height, format: format}) do
    bytes = width * height * Situ.Image.Format.bytes_per_pixel(format)
    @batch_bytes |> div(bytes) |> max(1) |> min(@most_images)
  end

  defp decode_messages(store, info, ordinal, messages) do
    case fetch_module() do
      {:ok, module} -> module.decode_messages(store, info, ordinal, messages)
      {:error, error} -> Enum.map(messages, &put_undecoded(&1, error.what))
    end
  end

  @doc "Replaces the packet of a message by the reason why it is not decoded."
  @spec put_undecoded(Message.t(), String.t()) :: Message.t()
  def put_undecoded(%{data: %VideoPacket{} = packet} = message, reason) do
    codec = VideoPacket.codec_name()
    %{message | data: %Undecoded{codec: codec, bytes: packet.data, reason: reason}}
  end

  def put_undecoded(message, _reason), do: message

  @doc "Returns whether a stream of images begins with a packet. Reads one message if the catalog does not contain it."
  @spec stored_as_video?(Recording.t(), StreamInfo.t()) :: boolean()
  def stored_as_video?(store, %{type: type} = info) when type in [Situ.Image, VideoPacket],
    do: names_codec?(info) or match?({:ok, %VideoPacket{}}, first_packet(store, info))

  def stored_as_video?(_store, _info), do: false

  defp names_codec?(info),
    do: Enum.any?(info.codecs, fn {_, {name, _}} -> name == VideoPacket.codec_name() end)

  defp first_packet(_store, %{codecs: codecs}) when map_size(codecs) > 0, do: :none

  defp first_packet(store, info) do
    case read_packet(store, info, 0) do
      {:ok, [%{data: %VideoPacket{} = packet} | _], _} -> {:ok, packet}
      _ -> :none
    end
  end

  @doc """
  Returns the ordinal where a copy that begins at `ordinal` has to start, so that its first image can be decoded: that
  of the key frame before it.
  """
  @spec find_key(Recording.t(), StreamInfo.t(), non_neg_integer()) :: non_neg_integer()
  def find_key(store, info, ordinal) do
    with true <- names_codec?(info) or map_size(info.codecs) == 0,
         true <- info.type in [Situ.Image, VideoPacket],
         {:ok, [%{data: %VideoPacket{position: position}}], _} <-
           read_packet(store, info, ordinal) do
      max(ordinal - position, 0)
    else
      _ -> ordinal
    end
  end

  @doc """
  Describes the packets of a stream. Returns `:none` if it has none, and an error for a recording that is growing,
  because a program that decodes the packets would not learn of new ones.
  """
  @spec describe_packets(Recording.t(), StreamInfo.t()) ::
          {:ok, Recording.CodedVideo.t()} | :none | {:error, Error.t()}
  def describe_packets(store, info) do
    with true <- stored_as_video?(store, info) || :none,
         :ok <- check_ended(store, info),
         {:ok, module} <- fetch_module(),
         do: module.describe_packets(store, info)
  end

  defp check_ended(store, info) do
    if store.module.info(store.state).live?,
      do: {:error, Error.new(:not_coded, "#{inspect(info.name)} is still being recorded")},
      else: :ok
  end

  # Everything above the recording's module decodes packets.
  defp read_packet(store, info, ordinal),
    do: store.module.read(store.state, info, ordinal, :unbounded, 1, exact: true, packets: true)

  @spec fetch_module() :: {:ok, module()} | {:error, Error.t()}
  defp fetch_module do
    modules =
      for {app, _, _} <- Application.loaded_applications(),
          module = Application.get_env(app, :video_coder),
          do: {app, module}

    case modules do
      # A program may have loaded the application without starting it.
      [{app, module} | _] ->
        {:ok, _} = Application.ensure_all_started(app)
        {:ok, module}

      [] ->
        {:error,
         Error.new(:no_video_coder, "this system cannot decode or encode video",
           why: "the application situ_media is not loaded",
           fix: "add situ_media to the applications of your project"
         )}
    end
  end
end
