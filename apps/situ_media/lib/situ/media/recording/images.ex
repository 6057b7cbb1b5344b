defmodule Situ.Media.Recording.Images do
  @moduledoc false
  # Decodes the images of one media file on request, from a decoder's position if it is close enough, else from the
  # previous key frame. Recently decoded images are cached, so that small steps back cost nothing.
  use GenServer

  alias Situ.Media.Decoder
  alias Situ.Media.Recording.{Servers, Index, OpenFile}

  @idle_ms 20_000
  @cache_bytes 64 * 1_048_576
  # Maximum size of one reply, however many images are requested.
  @answer_bytes 16 * 1_048_576
  # After a step back by at most this many images, the previous images are likely to be requested next, so they are
  # decoded together.
  @back 24
  # One decoder for a replay, and one for a user who looks at another time.
  @decoders 2
  # Rough costs of a decoder: its start, each pixel of an image that it skips (decoded only), and each pixel of an image
  # that it returns (also converted to BGR and sent).
  @start_ns 80_000_000
  @skip_ns 1.5
  @read_ns 6.0

  defstruct [:recording, :last_ordinal, decoders: [], cache: %{}, order: :queue.new(), bytes: 0]

  @doc """
  Returns up to `limit` images from `ordinal` as `{:ok, [{ordinal, image}]}`. Fewer images are returned if they are
  large, and none at the end.
  """
  @spec fetch_range(OpenFile.t(), non_neg_integer(), pos_integer()) ::
          {:ok, [{non_neg_integer(), Situ.Image.t()}]} | {:error, Situ.Error.t()}
  def fetch_range(recording, ordinal, limit),
    do: Servers.call_server(__MODULE__, recording, {ordinal, limit})

  @impl true
  def init(recording) do
    # If a decoder crashes, only the current request fails.
    Process.flag(:trap_exit, true)
    {:ok, %__MODULE__{recording: recording}, @idle_ms}
  end

  @impl true
  def handle_call({ordinal, limit}, _from, state) do
    {result, state} =
      case OpenFile.check_unchanged(state.recording) do
        :ok -> fetch_images(state, ordinal, min(limit, max_images(state.recording)))
        error -> {error, state}
      end

    {:reply, result, %{state | last_ordinal: ordinal}, @idle_ms}
  end

  @impl true
  def handle_info(:timeout, state), do: {:stop, :normal, state}
  def handle_info(_, state), do: {:noreply, state, @idle_ms}

  @impl true
  def terminate(_reason, state), do: Enum.each(state.decoders, &Decoder.close(elem(&1, 1)))

  defp fetch_images(state, ordinal, limit) do
    case cached_images(state, ordinal, limit) do
      [] -> decode_images(state, ordinal, limit)
      pictures -> {{:ok, pictures}, state}
    end
  end

  defp max_images(%{info: %{video: video}}),
    do: max(div(@answer_bytes, max(video.width * video.height * 3, 1)), 1)

  defp cached_images(state, ordinal, limit) do
    ordinal
    |> Stream.iterate(&(&1 + 1))
    |> Stream.take_while(&is_map_key(state.cache, &1))
    |> Enum.take(limit)
    |> Enum.map(&{&1, state.cache[&1]})
  end

  defp decode_images(state, ordinal, limit) do
    case take_decoder(state, ordinal) do
      {:ok, {next, decoder}, others} ->
        decode_until(%{state | decoders: others}, next, decoder, {ordinal, limit}, [])

      {:error, error} ->
        {{:error, error}, state}
    end
  end

  # Takes a decoder that is close enough to the image, or opens a new one.
  defp take_decoder(%{recording: %{index: index}} = state, ordinal) do
    key = Index.key_image(index, ordinal)
    at = Enum.filter(state.decoders, fn {next, _} -> next <= ordinal end)
    nearest = Enum.max_by(at, &elem(&1, 0), fn -> nil end)

    if nearest && worth_continuing?(state.recording, ordinal - elem(nearest, 0), ordinal - key),
      do: {:ok, nearest, List.delete(state.decoders, nearest)},
      else: open_decoder(state, first_wanted(state, ordinal, key))
  end

  # A running decoder returns every image up to the target, while a new one skips them but begins at the key frame.
  defp worth_continuing?(%{info: %{video: video}}, ahead, from_key) do
    pixels = video.width * video.height
    ahead * pixels * (@skip_ns + @read_ns) <= @start_ns + from_key * pixels * @skip_ns
  end

  defp first_wanted(%{last_ordinal: last_ordinal}, ordinal, key)
       when last_ordinal != nil and (last_ordinal - ordinal) in 1..@back,
       do: max(key, ordinal - @back)

  defp first_wanted(_state, ordinal, _key), do: ordinal

  defp open_decoder(%{recording: recording} = state, from) do
    {keep, close} = Enum.split(state.decoders, @decoders - 1)
    Enum.each(close, &Decoder.close(elem(&1, 1)))
    opts = [start: seek_time(recording.index, from), audio: false]

    case Decoder.open(recording.path, recording.info, opts) do
      {:ok, decoder} -> {:ok, {from, decoder}, keep}
      {:error, error} -> {:error, error}
    end
  end

  # Seeks to a time between the image and the previous one, since ffmpeg seeks in microseconds.
  defp seek_time(_index, 0), do: 0

  defp seek_time(index, ordinal) do
    time = Index.image_time(index, ordinal)
    time - min(div(time - Index.image_time(index, ordinal - 1), 2), 1_000_000)
  end

  defp decode_until(state, next, decoder, {_, limit}, found) when length(found) == limit,
    do: {{:ok, Enum.reverse(found)}, %{state | decoders: [{next, decoder} | state.decoders]}}

  defp decode_until(state, next, decoder, {ordinal, _} = wanted, found) do
    case Decoder.next_item(decoder) do
      {:video, time, image, decoder} ->
        at = max(Index.nearest_image(state.recording.index, time), next)

        cond do
          # The file has more images than its packets stated.
          at >= Index.image_count(state.recording.index) ->
            decode_until(state, at, decoder, wanted, found)

          at >= ordinal ->
            decode_until(cache_image(state, at, image), at + 1, decoder, wanted, [
              {at, image} | found
            ])

          true ->
            decode_until(cache_image(state, at, image), at + 1, decoder, wanted, found)
        end

      {:eof, decoder} ->
        Decoder.close(decoder)
        {{:ok, Enum.reverse(found)}, state}

      # Returns the images read so far first; the next read returns the error.
      {:error, error, decoder} ->
        Decoder.close(decoder)
        {if(found == [], do: {:error, error}, else: {:ok, Enum.reverse(found)}), state}
    end
  end

  defp cache_image(%{cache: cache} = state, ordinal, _image) when is_map_key(cache, ordinal),
    do: state

  defp cache_image(state, ordinal, image) do
    evict_oldest(%{
      state
      | cache: Map.put(state.cache, ordinal, image),
        order: :queue.in(ordinal, state.order),
        bytes: state.bytes + byte_size(image.data)
    })
  end

  defp evict_oldest(%{bytes: bytes} = state)
       when bytes <= @cache_bytes or map_size(state.cache) == 1,
       do: state

  defp evict_oldest(state) do
    {{:value, ordinal}, order} = :queue.out(state.order)
    {image, cache} = Map.pop!(state.cache, ordinal)

    evict_oldest(%{state | cache: cache, order: order, bytes: state.bytes - byte_size(image.data)})
  end
end
