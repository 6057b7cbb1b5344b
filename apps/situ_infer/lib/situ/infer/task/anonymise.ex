defmodule Situ.Infer.Task.Anonymise do
  @moduledoc false
  # The batch task `anonymise`. It copies the streams of a session into one partition, hides
  # faces, mutes the audio where it identifies people, and leaves out streams that must stay
  # private.
  #
  # Faces are found by a detector that may miss some (`Situ.Infer.FaceBlur`), so check the result
  # before you share it.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.{AudioBuffer, AudioFormat}

  @second 1_000_000_000

  @doc "Returns the task's description."
  @spec task() :: map()
  def task do
    %{
      name: "anonymise",
      about:
        "copy a session's streams into one partition with faces hidden, intervals muted and streams left out",
      output: "Anonymous",
      options: [
        blur: [
          type: {:list, :string},
          default: ["*"],
          doc: "Image streams whose faces are hidden; * matches any text. They become JPEG."
        ],
        mute: [
          type: {:list, :string},
          default: [],
          doc:
            "Time spans in which all audio is muted, in seconds since the start of the session: 12.5-14."
        ],
        drop: [
          type: {:list, :string},
          default: [],
          doc: "Streams that are left out; * matches any text."
        ],
        hold: [
          type: {:range, 0.0, 60.0},
          default: 0.5,
          doc:
            "How long a face is hidden before its first and after its last detection, in seconds."
        ],
        min_score: [
          type: {:range, 0.01, 0.99},
          default: 0.3,
          doc: "The minimum score of a face."
        ],
        quality: [type: {:integer, 1, 100}, default: 90, doc: "The quality of the JPEG."]
      ]
    }
  end

  @doc "Builds the pipeline of one session."
  @spec build(Situ.Graph.Handle.t(), keyword()) :: term()
  def build(_p, opts) do
    spans = parse_spans(opts[:mute], session_start(opts[:streams]))

    streams =
      Enum.reject(opts[:streams], fn {_, info} -> matches_any?(info.name, opts[:drop]) end)

    names = for {_, info} <- streams, do: info.name

    for {partition, info} <- streams do
      # A stream name that exists in several partitions is prefixed with its partition.
      name =
        if Enum.count(names, &(&1 == info.name)) > 1,
          do: "#{partition}.#{info.name}",
          else: info.name

      "[#{partition}]:#{info.name}"
      |> opts[:open].()
      |> anonymise_stream(info, spans, opts)
      |> opts[:write].(name)
    end
  end

  defp anonymise_stream(stream, %{type: AudioBuffer}, [_ | _] = spans, _opts),
    do: Situ.map(stream, &mute_spans(&1, &2.originating_time, spans), type: AudioBuffer)

  defp anonymise_stream(stream, %{type: type} = info, _spans, opts)
       when type in [Situ.Image, Situ.EncodedImage] do
    if matches_any?(info.name, opts[:blur]), do: blur_faces(stream, type, opts), else: stream
  end

  defp anonymise_stream(stream, _info, _spans, _opts), do: stream

  defp blur_faces(stream, type, opts) do
    pictures = if type == Situ.EncodedImage, do: Situ.ImageStream.decode(stream), else: stream
    detector = [min_score: opts[:min_score], tile_score: max(opts[:min_score], 0.5), every: 0]

    pictures
    |> Situ.join(Situ.via(pictures, Situ.Infer.FaceDetector, detector))
    |> Situ.via(Situ.Infer.FaceBlur, hold: round(opts[:hold] * @second))
    |> Situ.ImageStream.encode_jpeg(quality: opts[:quality])
  end

  defp session_start(streams) do
    streams
    |> Enum.map(fn {_, info} -> info.first end)
    |> Enum.reject(&is_nil/1)
    |> Enum.min(fn -> 0 end)
  end

  defp parse_spans(texts, start),
    do: for(text <- texts, do: text |> parse_span!() |> shift_span(start))

  defp shift_span({from, to}, start), do: {start + from, start + to}

  @doc """
  Parses a time span such as `12.5-14` into nanoseconds; raises `Situ.Error`, `:bad_option`.

      iex> Situ.Infer.Task.Anonymise.parse_span!("12.5-14")
      {12_500_000_000, 14_000_000_000}
  """
  @spec parse_span!(String.t()) :: {Situ.Time.duration(), Situ.Time.duration()}
  def parse_span!(text) do
    with [from, to] <- String.split(text, "-"),
         {from, ""} <- Float.parse(String.trim(from)),
         {to, ""} <- Float.parse(String.trim(to)),
         true <- from < to do
      {round(from * @second), round(to * @second)}
    else
      _ ->
        raise Situ.Error.new(:bad_option, "#{inspect(text)} is not a time span",
                fix: "write seconds since the start of the session, such as 12.5-14"
              )
    end
  end

  defp matches_any?(name, patterns), do: Enum.any?(patterns, &(name =~ compile_pattern(&1)))

  defp compile_pattern(text) do
    source = text |> String.split("*") |> Enum.map_join(".*", &Regex.escape/1)
    Regex.compile!("\\A" <> source <> "\\z", "su")
  end

  @doc """
  Mutes an audio buffer that ends at `time` within the spans (in ns, the end excluded).

      iex> buffer = Situ.AudioBuffer.from_samples([1, 2, 3, 4], Situ.AudioFormat.pcm(4))
      iex> muted = Situ.Infer.Task.Anonymise.mute_spans(buffer, 1_000_000_000, [{250_000_000, 750_000_000}])
      iex> Situ.AudioBuffer.to_samples(muted)
      [1, 0, 0, 4]
  """
  @spec mute_spans(AudioBuffer.t(), Situ.Time.t(), [{Situ.Time.t(), Situ.Time.t()}]) ::
          AudioBuffer.t()
  def mute_spans(%AudioBuffer{format: format, data: data} = buffer, time, spans) do
    size = AudioFormat.bytes_per_frame(format)
    frames = div(byte_size(data), size)

    data =
      Enum.reduce(spans, data, fn {from, to}, data ->
        first = frames + Integer.floor_div((from - time) * format.rate, @second)
        stop = frames - Integer.floor_div((time - to) * format.rate, @second)
        {first, stop} = {clamp_frame(first, frames), clamp_frame(stop, frames)}
        silence_bytes(data, first * size, (stop - first) * size, format.sample)
      end)

    %{buffer | data: data}
  end

  # A frame that is partly within a span is muted.
  defp clamp_frame(frame, frames), do: frame |> max(0) |> min(frames)

  defp silence_bytes(data, _at, 0, _sample), do: data

  defp silence_bytes(data, at, length, sample) do
    <<before::binary-pinned_size(at), _::binary-pinned_size(length), rest::binary>> = data
    silence = if sample == :u8, do: <<128>>, else: <<0>>
    IO.iodata_to_binary([before, :binary.copy(silence, length), rest])
  end
end
