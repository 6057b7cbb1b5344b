defmodule Situ.Media.WavWriter do
  @moduledoc """
  A sink that writes audio to a WAV file. The first buffer sets the format, and its start becomes the file's start time,
  which `Situ.Media.WavFile` reads.

      stream |> Situ.Media.WavWriter.write("out.wav")
  """

  alias Situ.AudioBuffer
  alias Situ.Media.Wav.Writer

  @schema [
    path: [type: :string, required: true, doc: "The file to write; an existing file is replaced."],
    fill_gaps: [
      type: :boolean,
      default: false,
      doc:
        "Fill gaps of more than 1 ms with silence, so that positions in the file match stream times."
    ]
  ]

  use Situ.Component, inputs: [in: AudioBuffer], options: @schema

  # Longer gaps separate two recordings, and filling them would fill the file with silence.
  @longest_gap 3_600_000_000_000

  @doc "Connects the sink to `stream` and returns `stream`."
  @spec write(Situ.Stream.t(), Path.t(), keyword()) :: Situ.Stream.t()
  def write(stream, path, opts \\ []) do
    Situ.via(stream, __MODULE__, [path: path] ++ opts)
    stream
  end

  @impl true
  def init(opts), do: {:ok, %{opts: opts, writer: nil, end: nil}}

  @impl true
  def handle_message(:in, message, _context, state) do
    %{data: buffer, originating_time: time} = message
    start = AudioBuffer.start_time(buffer, time)
    state = if state.writer, do: state, else: open_writer(buffer, start, state)
    writer = state.writer |> fill_gap(start - state.end, state.opts) |> append_buffer(buffer)
    {[], %{state | writer: writer, end: time}}
  end

  @impl true
  def terminate(_reason, %{writer: nil}), do: :ok
  def terminate(_reason, %{writer: writer}), do: Situ.Error.unwrap!(Writer.finish_file(writer))

  @impl true
  def handle_closed(:in, _time, _context, %{writer: nil} = state), do: {[], state}

  def handle_closed(:in, _time, _context, state) do
    Situ.Error.unwrap!(Writer.finish_file(state.writer))
    {[], %{state | writer: nil}}
  end

  defp open_writer(buffer, start, state) do
    case Writer.open(state.opts[:path], buffer.format, start_time: start) do
      {:ok, writer} -> %{state | writer: writer, end: start}
      {:error, error} -> raise error
    end
  end

  defp fill_gap(writer, gap, opts) do
    if opts[:fill_gaps] and gap > 1_000_000 do
      if gap > @longest_gap, do: raise(too_long(opts[:path], gap))
      write_silence(writer, Situ.AudioFormat.ns_to_frames(writer.format, gap))
    else
      writer
    end
  end

  # Writes one second at a time, because an hour of many channels would be gigabytes.
  defp write_silence(%{format: format} = writer, frames) do
    second = AudioBuffer.build_silence(format, format.rate)
    rest = AudioBuffer.build_silence(format, rem(frames, format.rate))
    seconds = List.duplicate(second, div(frames, format.rate))
    Enum.reduce(seconds ++ [rest], writer, &append_buffer(&2, &1))
  end

  defp append_buffer(writer, buffer) do
    case Writer.append_buffer(writer, buffer) do
      {:ok, writer} -> writer
      {:error, error} -> raise error
    end
  end

  defp too_long(path, gap) do
    Situ.Error.new(
      :gap_too_long,
      "gap of #{Situ.Time.format_duration(gap)} in the audio for #{Path.basename(path)}",
      why: "fill_gaps: writes at most one hour of silence",
      fix: "write one file per recording"
    )
  end
end
