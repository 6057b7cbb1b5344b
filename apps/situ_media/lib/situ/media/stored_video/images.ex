defmodule Situ.Media.StoredVideo.Images do
  @moduledoc false
  # Decodes the packets of one stream of a recording on request. A running decoder continues if it is close before the
  # packet; otherwise another one starts at the key frame. The images that were read last are kept.
  use GenServer

  alias Situ.{Image, VideoPacket}
  alias Situ.Media.StoredVideo.PacketDecoder
  alias Situ.Store.{Query, VideoCoder}

  @idle_ms 20_000
  @cache_bytes 32 * 1_048_576
  # One decoder for a replay, and one for a user who looks at another time.
  @decoders 2
  # A running decoder returns every image, which is slower than decoding alone.
  @most_ahead 24
  @no_key "the packets before it, from a key frame on, are not in the recording"

  # `decoders`: a list of {ordinal of the next packet, decoder}, the last one used first.
  defstruct [:store, :info, decoders: [], cache: []]

  @impl true
  def init(source) do
    # If a decoder crashes, only the current request fails.
    Process.flag(:trap_exit, true)
    {:ok, %__MODULE__{store: source.store, info: source.info}, @idle_ms}
  end

  @impl true
  def handle_call({ordinal, messages}, _from, state) do
    {decoded, state} = fetch_images(state, ordinal, messages)
    {:reply, decoded, state, @idle_ms}
  end

  @impl true
  def handle_info(:timeout, state), do: {:stop, :normal, state}
  def handle_info(_, state), do: {:noreply, state, @idle_ms}

  @impl true
  def terminate(_reason, state),
    do: Enum.each(state.decoders, fn {_, decoder} -> PacketDecoder.close(decoder) end)

  defp fetch_images(state, ordinal, messages) do
    times = Enum.map(messages, & &1.originating_time)

    case List.keyfind(state.cache, times, 0) do
      {_, decoded} ->
        {decoded, state}

      nil ->
        {decoded, state} = decode_batch(state, ordinal, messages)
        {decoded, put_cached(state, {times, decoded})}
    end
  end

  defp put_cached(state, entry) do
    {cache, _} =
      Enum.flat_map_reduce([entry | state.cache], 0, fn {_, messages} = entry, bytes ->
        bytes = bytes + Enum.sum(Enum.map(messages, &image_bytes(&1.data)))
        if bytes <= @cache_bytes, do: {[entry], bytes}, else: {:halt, bytes}
      end)

    %{state | cache: cache}
  end

  defp image_bytes(%Image{data: data}), do: byte_size(data)
  defp image_bytes(_other), do: 0

  defp decode_batch(state, ordinal, messages) do
    {decoder, state} = prepare_decoder(state, ordinal, hd(messages).data)
    {decoded, decoder} = Enum.map_reduce(messages, decoder, &decode_message/2)
    {decoded, keep_decoder(state, ordinal + length(messages), decoder)}
  end

  # The decoder is nil before a key frame, and the reason why there is none after an error.
  defp decode_message(%{data: %VideoPacket{} = packet} = message, decoder) do
    with {:ok, decoder} <- ensure_decoder(decoder, packet, 0),
         {:ok, image, decoder} <- PacketDecoder.decode(decoder, packet) do
      {%{message | data: image}, decoder}
    else
      {:error, error} ->
        reason = describe_error(error)
        if is_struct(decoder), do: PacketDecoder.close(decoder)
        {VideoCoder.put_undecoded(message, reason), reason}
    end
  end

  # A stream may contain images that are stored as they are.
  defp decode_message(message, decoder), do: {message, decoder}

  defp describe_error(reason) when is_binary(reason), do: reason
  defp describe_error(error), do: Exception.message(error)

  defp ensure_decoder(%PacketDecoder{} = decoder, packet, skipped) do
    cond do
      PacketDecoder.accepts?(decoder, packet) -> {:ok, decoder}
      VideoPacket.key?(packet) -> replace_decoder(decoder, packet, skipped)
      true -> {:error, @no_key}
    end
  end

  defp ensure_decoder(none, packet, skipped) do
    if VideoPacket.key?(packet),
      do: PacketDecoder.open(packet, skipped),
      else: {:error, none || @no_key}
  end

  defp replace_decoder(decoder, packet, skipped) do
    PacketDecoder.close(decoder)
    PacketDecoder.open(packet, skipped)
  end

  # Returns a decoder that takes the packet next, nil if the packet is a key frame, or the reason why there is none.
  defp prepare_decoder(state, ordinal, %VideoPacket{position: position}) do
    case Enum.find(state.decoders, &decoder_continues?(&1, ordinal, position)) do
      {from, decoder} = found ->
        state = %{state | decoders: List.delete(state.decoders, found)}
        {pass_packets(state, decoder, from, ordinal), state}

      nil when position == 0 ->
        {nil, state}

      nil ->
        {start_at_key(state, ordinal - position, ordinal), state}
    end
  end

  defp decoder_continues?({next, _decoder}, ordinal, 0), do: next == ordinal

  defp decoder_continues?({next, decoder}, ordinal, position) do
    ahead = ordinal - next
    ahead in 0..min(@most_ahead, position - 1)//1 and decoder.position + ahead == position
  end

  # Decodes up to the wanted packet with a decoder that returns every image.
  defp pass_packets(state, decoder, from, to) do
    feed_packets(state, {from, to}, decoder, fn packet, decoder ->
      with {:ok, decoder} <- ensure_decoder(decoder, packet, 0),
           {:ok, _image, decoder} <- PacketDecoder.decode(decoder, packet),
           do: {:ok, decoder}
    end)
  end

  defp start_at_key(_state, key, _to) when key < 0, do: @no_key

  defp start_at_key(state, key, to) do
    feed_packets(state, {key, to}, nil, fn packet, decoder ->
      with {:ok, decoder} <- ensure_decoder(decoder, packet, to - key),
           do: PacketDecoder.skip(decoder, packet)
    end)
  end

  defp feed_packets(_state, {to, to}, decoder, _feed), do: decoder

  defp feed_packets(state, {from, to}, decoder, feed) do
    opts = [exact: true, packets: true]

    with {:ok, [_ | _] = messages, next} when next <= to <-
           Query.read_batch(state.store, state.info, from, :unbounded, to - from, opts),
         {:ok, decoder} <- feed_each(messages, decoder, feed) do
      feed_packets(state, {next, to}, decoder, feed)
    else
      {:error, error, decoder} -> drop_decoder(decoder, describe_error(error))
      _ -> drop_decoder(decoder, @no_key)
    end
  end

  defp feed_each(messages, decoder, feed) do
    Enum.reduce_while(messages, {:ok, decoder}, fn
      %{data: %VideoPacket{} = packet}, {:ok, decoder} ->
        case feed.(packet, decoder) do
          {:ok, decoder} -> {:cont, {:ok, decoder}}
          {:error, error} -> {:halt, {:error, error, decoder}}
        end

      _other, {:ok, decoder} ->
        {:halt, {:error, @no_key, decoder}}
    end)
  end

  defp drop_decoder(decoder, reason) do
    if is_struct(decoder), do: PacketDecoder.close(decoder)
    reason
  end

  defp keep_decoder(state, next, %PacketDecoder{} = decoder) do
    {keep, close} = Enum.split([{next, decoder} | state.decoders], @decoders)
    for {_, decoder} <- close, do: PacketDecoder.close(decoder)
    %{state | decoders: keep}
  end

  defp keep_decoder(state, _next, _none), do: state
end
