defmodule Situ.Studio.CodedStreams do
  @moduledoc false
  # Finds the compressed images of a stream, which a page decodes by itself, in the recording that contains them:
  # sessions, comparisons and derived streams only pass them on. See
  # docs/adr/0189-the-page-decodes-compressed-video.md.
  alias Situ.{Error, Recording, Store}
  alias Situ.Media.SmallCopies
  alias Situ.Recording.CodedVideo
  alias Situ.Studio.Recordings

  @doc "Describes the images of a stream, with the times that they have in `recording`."
  @spec fetch(Recording.t(), String.t()) :: {:ok, CodedVideo.t()} | :none | {:error, Error.t()}
  def fetch(recording, name) do
    with {:ok, info} <- Store.stream_info(recording, name),
         {:ok, {recording, info, offset}} <- find_origin(recording, info, 0),
         {:ok, video} <- CodedVideo.fetch(recording, info),
         do: {:ok, CodedVideo.shift_times(video, offset)}
  end

  @doc "Returns the bytes of `count` packets, beginning with number `first`."
  @spec read_packets(Recording.t(), String.t(), non_neg_integer(), non_neg_integer()) ::
          {:ok, [binary()]} | :none | {:error, Error.t()}
  def read_packets(recording, name, first, count) do
    with {:ok, info} <- Store.stream_info(recording, name),
         {:ok, {recording, info, _offset}} <- find_origin(recording, info, 0),
         do: CodedVideo.read_packets(recording, info, first, count)
  end

  @doc """
  Describes small copies of the images, each of which can be decoded alone. Returns `:pending` while they are made, and
  `:none` for a stream that has none.
  """
  @spec fetch_small(Recording.t(), String.t()) ::
          {:ok, CodedVideo.t()} | :pending | :none | {:error, Error.t()}
  def fetch_small(recording, name) do
    with {:ok, {copy, info, offset}} <- find_small(recording, name),
         {:ok, video} <- CodedVideo.fetch(copy, info),
         do: {:ok, CodedVideo.shift_times(video, offset)}
  end

  @doc "Returns the bytes of packets of small copies."
  @spec read_small_packets(Recording.t(), String.t(), non_neg_integer(), non_neg_integer()) ::
          {:ok, [binary()]} | :pending | :none | {:error, Error.t()}
  def read_small_packets(recording, name, first, count) do
    with {:ok, {copy, info, _offset}} <- find_small(recording, name),
         do: CodedVideo.read_packets(copy, info, first, count)
  end

  defp find_small(recording, name) do
    with {:ok, info} <- Store.stream_info(recording, name),
         {:ok, {%{module: Situ.Media.Recording, state: file}, info, offset}} <-
           find_origin(recording, info, 0),
         {:ok, copy} <- SmallCopies.fetch(file),
         {:ok, info} <- Store.stream_info(copy, info.name) do
      {:ok, {copy, info, offset}}
    else
      {:ok, _other_recording} -> :none
      other -> other
    end
  end

  # An adapter and an expression make other data of the images.
  defp find_origin(%{module: Recordings.Adapted}, _info, _offset), do: :none
  defp find_origin(_recording, %{extra: %{expression: _}}, _offset), do: :none

  defp find_origin(%{module: Recordings.Store, state: state}, info, offset),
    do: {:ok, {state.recording, info, offset}}

  # Recordings around a comparison pass on its additions to the information, but do not shift the times again.
  defp find_origin(
         %{module: Recordings.Comparison},
         %{extra: %{origin: {recording, info}, offset: shift}},
         offset
       ),
       do: find_origin(recording, info, offset + shift)

  defp find_origin(_recording, %{extra: %{origin: {recording, info}}}, offset),
    do: find_origin(recording, info, offset)

  defp find_origin(recording, info, offset), do: {:ok, {recording, info, offset}}

  @doc """
  Returns a description for a page. `packets` is compressed (zlib) and in Base64: three columns, with the times of the
  images as differences in ns (64-bit integers), then the sizes (32 bits), then 1 for a key frame, 2 for a packet that
  is not shown, 3 for both (8 bits). The first time is relative to `start`. All numbers are little-endian.

      iex> video = %Situ.Recording.CodedVideo{
      ...>   codec: "vp8", description: <<1>>, width: 4, height: 2, packets: <<50::64, 7::32, 1, 90::64, 5::32, 0>>}
      iex> map = Situ.Studio.CodedStreams.to_map(video)
      iex> {map["start"], map["count"], map["description"]}
      {"50", 2, "AQ=="}
      iex> <<0::little-64, 40::little-64, 7::little-32, 5::little-32, 1, 0>> =
      ...>   map["packets"] |> Base.decode64!() |> :zlib.uncompress()
  """
  @spec to_map(CodedVideo.t()) :: map()
  def to_map(%CodedVideo{} = video) do
    rows = CodedVideo.list_packets(video)
    start = Enum.find_value(rows, 0, fn {time, _, _} -> time != :hidden && time end)

    %{
      "codec" => video.codec,
      "description" => Base.encode64(video.description),
      "width" => video.width,
      "height" => video.height,
      "rotation" => video.rotation,
      "color" => video.color,
      "start" => Integer.to_string(start),
      "count" => length(rows),
      "packets" => rows |> pack_columns(start) |> :zlib.compress() |> Base.encode64()
    }
  end

  defp pack_columns(rows, start) do
    {steps, _} =
      Enum.map_reduce(rows, start, fn
        {:hidden, _, _}, last -> {<<0::64>>, last}
        {time, _, _}, last -> {<<time - last::little-signed-64>>, time}
      end)

    sizes = for {_, size, _} <- rows, into: <<>>, do: <<size::little-32>>
    flags = for {time, _, key?} <- rows, into: <<>>, do: <<flag_bits(time, key?)::8>>
    IO.iodata_to_binary([steps, sizes, flags])
  end

  defp flag_bits(time, key?),
    do: if(key?, do: 1, else: 0) + if(time == :hidden, do: 2, else: 0)
end
