defmodule Situ.Media.Recording.Audio do
  @moduledoc false
  # Decodes the audio of one media file in sections of half a minute, and once completely for its waveform.
  use GenServer

  alias Situ.{AudioBuffer, AudioFormat}
  alias Situ.Media.Decoder
  alias Situ.Media.Recording.{Servers, OpenFile, Waveform}

  @idle_ms 120_000
  @kept 3
  # Audio decoders need some preceding data, and containers round the times of later data.
  @lead 200_000_000
  # Tolerated jitter, as a fraction of a second (1/200 s).
  @jitter 200

  defstruct [:recording, :waveform, stretches: []]

  @doc """
  Returns one section of audio, counted from 0, as `{:ok, data, error}`. The data is short if there is no more audio,
  and then `error` is the reason or `nil`.
  """
  @spec read_batch(OpenFile.t(), non_neg_integer()) ::
          {:ok, binary(), Situ.Error.t() | nil} | {:error, Situ.Error.t()}
  def read_batch(recording, number),
    do: Servers.call_server(__MODULE__, recording, {:stretch, number})

  @spec fetch_waveform(OpenFile.t()) :: {:ok, Waveform.t()} | {:error, Situ.Error.t()}
  def fetch_waveform(recording), do: Servers.call_server(__MODULE__, recording, :waveform)

  @impl true
  def init(recording) do
    Process.flag(:trap_exit, true)
    {:ok, %__MODULE__{recording: recording}, @idle_ms}
  end

  @impl true
  def handle_call({:stretch, number}, _from, state) do
    with nil <- List.keyfind(state.stretches, number, 0),
         {:ok, data, error} <- decode_batch(state.recording, number) do
      kept = Enum.take([{number, data, error} | state.stretches], @kept)
      {:reply, {:ok, data, error}, %{state | stretches: kept}, @idle_ms}
    else
      {^number, data, error} -> {:reply, {:ok, data, error}, state, @idle_ms}
      {:error, error} -> {:reply, {:error, error}, state, @idle_ms}
    end
  end

  def handle_call(:waveform, _from, %{waveform: nil} = state) do
    case build_waveform(state.recording) do
      {:ok, waveform} -> {:reply, {:ok, waveform}, %{state | waveform: waveform}, @idle_ms}
      {:error, error} -> {:reply, {:error, error}, state, @idle_ms}
    end
  end

  def handle_call(:waveform, _from, state), do: {:reply, {:ok, state.waveform}, state, @idle_ms}

  @impl true
  def handle_info(:timeout, state), do: {:stop, :normal, state}
  def handle_info(_, state), do: {:noreply, state, @idle_ms}

  defp decode_batch(recording, number) do
    %{format: format} = sound = recording.sound
    size = sound.step * OpenFile.chunks_per_batch()
    first = sound.first + number * size
    last = min(first + size, sound.first + sound.frames)
    from = max(AudioFormat.frames_to_ns(format, first) - @lead, 0)
    span = [start: from, end: AudioFormat.frames_to_ns(format, last) + @lead]

    with :ok <- OpenFile.check_unchanged(recording),
         {:ok, decoder} <- open_decoder(recording, span),
         {:ok, data, nil} <- collect_audio(Decoder.next_item(decoder), last, format, {first, []}) do
      # Fills a pause, since the audio continues in a later section.
      more? = last < sound.first + sound.frames
      missing = last - first - div(byte_size(data), AudioFormat.bytes_per_frame(format))
      {:ok, if(more?, do: data <> build_silence(format, missing), else: data), nil}
    end
  end

  defp open_decoder(recording, opts) do
    opts =
      [video: false, audio_format: recording.sound.format, audio_buffer: 1_000_000_000] ++ opts

    Decoder.open(recording.path, recording.info, opts)
  end

  # Places each buffer at its time: gaps are filled with silence, and audio outside the section is skipped.
  # Differences below @jitter are caused by rounding in the container (1 ms in Matroska), so the audio is treated as
  # contiguous.
  defp collect_audio({:audio, time, buffer, decoder}, last, format, {at, parts}) do
    n = AudioBuffer.frame_count(buffer)
    start = AudioFormat.ns_to_frames(format, time) - n
    start = if parts != [] and abs(start - at) <= div(format.rate, @jitter), do: at, else: start
    gap = min(max(start - at, 0), last - at)
    from = max(at - start, 0)
    n = min(n - from, last - at - gap)

    if n > 0 do
      parts = [AudioBuffer.slice_frames(buffer, from, n).data, build_silence(format, gap) | parts]
      collect_audio(Decoder.next_item(decoder), last, format, {at + gap + n, parts})
    else
      collect_audio(Decoder.next_item(decoder), last, format, {at, parts})
    end
  end

  defp collect_audio({:eof, decoder}, _last, _format, {_at, parts}),
    do: finish_collecting(decoder, parts, nil)

  # ffmpeg returned no data and reported no error, so this span contains no audio.
  defp collect_audio({:error, %{meta: %{log_lines: 0}}, decoder}, _last, _format, {_at, []}),
    do: finish_collecting(decoder, [], nil)

  defp collect_audio({:error, error, decoder}, _last, _format, {_at, parts}),
    do: finish_collecting(decoder, parts, error)

  defp finish_collecting(decoder, parts, error) do
    Decoder.close(decoder)
    {:ok, join_parts(parts), error}
  end

  defp join_parts(parts), do: parts |> Enum.reverse() |> IO.iodata_to_binary()
  defp build_silence(format, n), do: :binary.copy(<<0>>, n * AudioFormat.bytes_per_frame(format))

  defp build_waveform(recording) do
    with {:ok, decoder} <- open_decoder(recording, []) do
      add_all_points(Decoder.next_item(decoder), recording.start, Waveform.new())
    end
  end

  defp add_all_points({:audio, time, buffer, decoder}, start, waveform) do
    points = Situ.AudioOps.points!(buffer, start + time)
    add_all_points(Decoder.next_item(decoder), start, Waveform.add_points(waveform, points))
  end

  defp add_all_points({:eof, decoder}, _start, waveform), do: finish_waveform(decoder, waveform)
  # On an error, returns the waveform of the readable part.
  defp add_all_points({:error, _error, decoder}, _start, waveform),
    do: finish_waveform(decoder, waveform)

  defp finish_waveform(decoder, waveform) do
    Decoder.close(decoder)
    {:ok, Waveform.pack_bins(waveform)}
  end
end
