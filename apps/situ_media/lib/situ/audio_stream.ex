defmodule Situ.AudioStream do
  @moduledoc """
  Operators on streams of audio: resample, mix, convert channels, cut into frames, and extract acoustic features.

  Every function takes a stream of `Situ.AudioBuffer` first and returns a stream (or a map of streams). `Situ.AudioOps`
  has the same operations for single buffers.

      def build(p, _opts) do
        clip = Situ.Media.VideoFile.open(p, "talk1.mp4")
        speech = clip.audio |> Situ.AudioStream.to_mono() |> Situ.AudioStream.resample(16_000)
        features = Situ.AudioStream.features(speech, mel_bands: 40)
        features.log_energy |> Situ.each(&IO.inspect/1)
      end

  The originating time of a buffer is the time of its **end**, and every operator keeps it exact to the sample.
  All operators also take the common options `name:`, `policy:`, `async:` and `on_error:`.
  """
  alias Situ.Graph.Placement
  alias Situ.{AudioBuffer, AudioFormat, Error, Operator, AudioOps, Options, Stream}

  alias Situ.AudioStream.{
    Analyzer,
    Ducker,
    Level,
    Mixer,
    NoiseGate,
    Reframer,
    Resampler,
    Streamline
  }

  @doc """
  Resamples the stream to another rate in frames per second.

      iex> buffer = Situ.AudioBuffer.build_silence(Situ.AudioFormat.pcm(48_000), 960)
      iex> feed = for i <- 1..10, do: {i * 20_000_000, buffer}
      iex> resample = fn p -> p |> Situ.from_enumerable(feed) |> Situ.AudioStream.resample(16_000) end
      iex> out = Situ.to_list(resample, times: true)
      iex> {out |> List.last() |> elem(0), out |> Enum.map(&Situ.AudioBuffer.frame_count(elem(&1, 1))) |> Enum.sum()}
      {200_000_000, 3200}

  The filter (libsoxr) has linear phase, and its delay is compensated: frame `k` of the result is `k / rate` after the
  first input frame. The time of an output buffer is the input time minus the duration that is still inside the filter;
  the rest follows when the input closes. The sample type and channels do not change. When the input format changes, the
  filter is flushed and restarted.

  #{Options.docs(Keyword.delete(Resampler.options(), :rate))}
  """
  @spec resample(Stream.t(), pos_integer(), keyword()) :: Stream.t()
  def resample(stream, rate, opts \\ []), do: Situ.via(stream, Resampler, [rate: rate] ++ opts)

  @doc """
  Converts the sample type or the number of channels (`Situ.AudioOps.reformat/2`).

      iex> sound = Situ.AudioBuffer.from_samples([100, 300, 200, 400], Situ.AudioFormat.pcm(1000, 2))
      iex> build = fn s -> s.sound |> Situ.AudioStream.reformat(sample: :f32) |> Situ.map(& &1.format.sample) end
      iex> Situ.Test.run([sound: [{2_000_000, sound}]], build)
      {:ok, [{2_000_000, :f32}]}
  """
  @spec reformat(Stream.t(), keyword()) :: Stream.t()
  def reformat(stream, opts) do
    {placed, opts} = Placement.split_unchecked(opts, :component)
    map_buffers(stream, "Reformat", &Error.unwrap!(AudioOps.reformat(&1, opts)), placed)
  end

  @doc """
  Mixes all channels down to mono, as their mean.

      iex> sound = Situ.AudioBuffer.from_samples([100, 300, 200, 400], Situ.AudioFormat.pcm(1000, 2))
      iex> build = fn s -> s.sound |> Situ.AudioStream.to_mono() |> Situ.map(&Situ.AudioBuffer.to_samples/1) end
      iex> Situ.Test.run([sound: [{2_000_000, sound}]], build)
      {:ok, [{2_000_000, [200, 300]}]}
  """
  @spec to_mono(Stream.t(), keyword()) :: Stream.t()
  def to_mono(stream, opts \\ []),
    do: map_buffers(stream, "Mono", &Error.unwrap!(AudioOps.reformat(&1, channels: 1)), opts)

  @doc """
  Converts to stereo. A mono channel is copied to both sides, and stereo is unchanged.

      iex> sound = Situ.AudioBuffer.from_samples([300, 400], Situ.AudioFormat.pcm(1000))
      iex> build = fn s -> s.sound |> Situ.AudioStream.to_stereo() |> Situ.map(&Situ.AudioBuffer.to_samples/1) end
      iex> Situ.Test.run([sound: [{2_000_000, sound}]], build)
      {:ok, [{2_000_000, [300, 300, 400, 400]}]}
  """
  @spec to_stereo(Stream.t(), keyword()) :: Stream.t()
  def to_stereo(stream, opts \\ []),
    do: map_buffers(stream, "Stereo", &Error.unwrap!(AudioOps.reformat(&1, channels: 2)), opts)

  @doc """
  Selects one channel, counted from 0, as mono.

      iex> sound = Situ.AudioBuffer.from_samples([100, 300, 200, 400], Situ.AudioFormat.pcm(1000, 2))
      iex> build = fn s -> s.sound |> Situ.AudioStream.select_channel(1) |> Situ.map(&Situ.AudioBuffer.to_samples/1) end
      iex> Situ.Test.run([sound: [{2_000_000, sound}]], build)
      {:ok, [{2_000_000, [300, 400]}]}
  """
  @spec select_channel(Stream.t(), non_neg_integer(), keyword()) :: Stream.t()
  def select_channel(stream, channel, opts \\ []) do
    map_buffers(
      stream,
      "Channel #{channel}",
      &Error.unwrap!(AudioOps.select_channels(&1, [channel])),
      opts
    )
  end

  @doc """
  Mixes the channels with a matrix of gains (`Situ.AudioOps.remix/3`).

      iex> sound = Situ.AudioBuffer.from_samples([100, 300, 200, 400], Situ.AudioFormat.pcm(1000, 2))
      iex> remix = &Situ.AudioStream.remix(&1.sound, [[1, 0], [0, 0.5]])
      iex> {:ok, [{_time, mixed}]} = Situ.Test.run([sound: [{2_000_000, sound}]], remix)
      iex> Situ.AudioBuffer.to_samples(mixed)
      [100, 150, 200, 200]
  """
  @spec remix(Stream.t(), [[number()]], keyword()) :: Stream.t()
  def remix(stream, matrix, opts \\ []),
    do: map_buffers(stream, "Remix", &Error.unwrap!(AudioOps.remix(&1, matrix)), opts)

  @doc """
  Changes the volume by a factor or by `{:db, n}`.

      iex> sound = Situ.AudioBuffer.from_samples([100, 300, 200, 400], Situ.AudioFormat.pcm(1000, 2))
      iex> build = fn s -> s.sound |> Situ.AudioStream.gain(2) |> Situ.map(&Situ.AudioBuffer.to_samples/1) end
      iex> Situ.Test.run([sound: [{2_000_000, sound}]], build)
      {:ok, [{2_000_000, [200, 600, 400, 800]}]}
  """
  @spec gain(Stream.t(), number() | {:db, number()}, keyword()) :: Stream.t()
  def gain(stream, gain, opts \\ []),
    do: map_buffers(stream, "Gain", &Error.unwrap!(AudioOps.gain(&1, gain)), opts)

  @doc """
  Mixes two streams sample by sample, aligned by their times.

      iex> format = Situ.AudioFormat.pcm(1000)
      iex> a = [{2_000_000, Situ.AudioBuffer.from_samples([1, 1], format)}]
      iex> b = [{3_000_000, Situ.AudioBuffer.from_samples([10, 10], format)}]
      iex> mixed = Situ.to_list(fn p ->
      ...>   Situ.AudioStream.mix(Situ.from_enumerable(p, a), Situ.from_enumerable(p, b))
      ...> end)
      iex> Enum.flat_map(mixed, &Situ.AudioBuffer.to_samples/1)
      [1, 11, 10]

  Both streams need the same format. A gap in one stream is silent in the mix, and after one stream has closed, the
  other continues alone. Where a stream overlaps itself (its times go back), the audio that arrived first is kept.
  Buffers are emitted up to the time that both streams have reached. A gap in both streams whose silence would take
  more than 256 MiB (hours of speech) is the error `:gap_too_long`, because it means that a clock was set.

  #{Options.docs(Mixer.options())}
  """
  @spec mix(Stream.t(), Stream.t(), keyword()) :: Stream.t()
  def mix(stream, other, opts \\ []), do: Situ.via([in: stream, other: other], Mixer, opts)

  @doc """
  Cuts the audio into buffers of an exact size, given as `frames:` or `duration:`. `hop:` makes them overlap.

      iex> format = Situ.AudioFormat.pcm(1000)
      iex> sound = &Situ.AudioBuffer.from_samples(&1, format)
      iex> feed = [{3_000_000, sound.([1, 2, 3])}, {5_000_000, sound.([4, 5])}]
      iex> reframed = fn p -> p |> Situ.from_enumerable(feed) |> Situ.AudioStream.reframe(frames: 2) end
      iex> pairs = Situ.to_list(reframed, times: true)
      iex> for {time, buffer} <- pairs, do: {time, Situ.AudioBuffer.to_samples(buffer)}
      [{2_000_000, [1, 2]}, {4_000_000, [3, 4]}]

  The time of an output buffer is exact to the sample: the time of the input buffer minus the duration of the audio
  after the cut. If this time would not be later than the previous buffer (because input times do not agree with input
  lengths), the buffer is stamped 1 ns after the previous one. When the format changes, the rest of the old format is
  handled as `tail:` specifies. The time of that last buffer is the end of its audio, without the silence that pads
  it.

  #{Options.docs(Reframer.options())}
  """
  @spec reframe(Stream.t(), keyword()) :: Stream.t()
  def reframe(stream, opts), do: Situ.via(stream, Reframer, opts)

  @doc """
  Makes audio with gaps, overlaps or timing jitter contiguous, by one of these methods:

    * `:unpleat`: times are continuous. When they have drifted from the input times by more than `max_offset`, silence
      is inserted before a late buffer, or the beginning of an early buffer is cut off.
    * `:pleat`: each buffer is padded with silence or cut at its end to fill exactly the time since the previous one,
      and times do not change.
    * `:concatenate`: only the times change; they continue from the first buffer, ignoring gaps.

      iex> sound = &Situ.AudioBuffer.from_samples(&1, Situ.AudioFormat.pcm(1000))
      iex> feed = [{2_000_000, sound.([1, 2])}, {5_000_000, sound.([5])}]
      iex> build = fn s -> Situ.AudioStream.streamline(s.sound, method: :pleat) end
      iex> {:ok, pairs} = Situ.Test.run([sound: feed], build)
      iex> for {time, buffer} <- pairs, do: {time, Situ.AudioBuffer.to_samples(buffer)}
      [{2_000_000, [1, 2]}, {5_000_000, [5, 0, 0]}]

  A gap whose silence would take more than 256 MiB (hours of speech) is the error `:gap_too_long`, because it means that
  a clock was set. A change of format is an error, too.

  #{Options.docs(Streamline.options())}
  """
  @spec streamline(Stream.t(), keyword()) :: Stream.t()
  def streamline(stream, opts \\ []), do: Situ.via(stream, Streamline, opts)

  @doc """
  Extracts acoustic features from overlapping frames, as a map of streams.

      iex> silence = Situ.AudioBuffer.build_silence(Situ.AudioFormat.pcm(16_000), 400)
      iex> build = fn s ->
      ...>   Situ.map(Situ.AudioStream.features(s.sound, dither: 0).log_energy, &Float.round(&1, 1))
      ...> end
      iex> Situ.Test.run([sound: [{25_000_000, silence}]], build)
      {:ok, [{25_000_000, -92.1}]}

  | stream | of each frame |
  |---|---|
  | `:log_energy` | natural logarithm of the mean square after the window; silence: -92.1 |
  | `:zero_crossing_rate` | sign changes per sample; an exact 0 breaks a crossing |
  | `:energy` | sum of power over `start_hz..end_hz` |
  | `:low_energy`, `:high_energy` | the same up to `low_end_hz`, from `high_start_hz` |
  | `:entropy` | spectral entropy of `entropy_hz` from `start_hz` on, 0..1 |
  | `:spectrum` | list of `{re, im}`, bins below half the FFT size, not scaled (with `spectrum: true`) |
  | `:power` | their squared magnitudes (with `power: true`) |
  | `:log_mel` | logarithms of the power of `mel_bands` bands, samples scaled to -1..1 |
  | `:mfcc` | the first `mfcc` cepstral coefficients (orthonormal DCT-II of `:log_mel`) |

  Frames are `round(rate * frame)` samples, windowed by a periodic Hann window and padded to the next power of two for
  the Fourier transform. The time of a frame is the end of its last sample, exact to the sample. If there are several
  channels, only the first one is used. Integer samples are used unscaled (8 bit: 0..255), and floats are scaled to the
  16-bit range. The dither is seeded by the frame number, so results do not depend on how the audio was divided into
  buffers.

  #{Options.docs(Analyzer.options())}
  """
  @spec features(Stream.t(), keyword()) :: %{atom() => Stream.t()}
  def features(stream, opts \\ []), do: Situ.via(stream, Analyzer, opts)

  @doc """
  Computes the logarithms of `bands` mel bands (default 40) of each frame, as a stream of lists.

      iex> silence = Situ.AudioBuffer.build_silence(Situ.AudioFormat.pcm(16_000), 400)
      iex> build = fn s -> s.sound |> Situ.AudioStream.log_mel(bands: 8) |> Situ.map(&length/1) end
      iex> Situ.Test.run([sound: [{25_000_000, silence}]], build)
      {:ok, [{25_000_000, 8}]}
  """
  @spec log_mel(Stream.t(), keyword()) :: Stream.t()
  def log_mel(stream, opts \\ []) do
    {bands, opts} = Keyword.pop(opts, :bands, 40)
    features(stream, [dither: 0, mel_bands: bands] ++ opts).log_mel
  end

  @doc """
  Computes the first `count` (default 13) cepstral coefficients of `bands` mel bands (default 40), as a stream of lists.

      iex> silence = Situ.AudioBuffer.build_silence(Situ.AudioFormat.pcm(16_000), 400)
      iex> build = fn s -> s.sound |> Situ.AudioStream.mfcc(count: 5) |> Situ.map(&length/1) end
      iex> Situ.Test.run([sound: [{25_000_000, silence}]], build)
      {:ok, [{25_000_000, 5}]}
  """
  @spec mfcc(Stream.t(), keyword()) :: Stream.t()
  def mfcc(stream, opts \\ []) do
    {bands, opts} = Keyword.pop(opts, :bands, 40)
    {count, opts} = Keyword.pop(opts, :count, 13)
    features(stream, [dither: 0, mel_bands: bands, mfcc: count] ++ opts).mfcc
  end

  @doc """
  Measures the level of each buffer, as a stream of the structs that `Situ.AudioOps.level/1` returns.

      iex> sound = Situ.AudioBuffer.from_samples([8192, -16_384], Situ.AudioFormat.pcm(1000))
      iex> build = fn s -> s.sound |> Situ.AudioStream.level() |> Situ.map(& &1.peak) end
      iex> Situ.Test.run([sound: [{2_000_000, sound}]], build)
      {:ok, [{2_000_000, 0.5}]}
  """
  @spec level(Stream.t(), keyword()) :: Stream.t()
  def level(stream, opts \\ []) do
    Operator.attach(stream, "Level", {:map, &Error.unwrap!(AudioOps.level(&1))}, opts, Level)
  end

  @doc """
  Passes audio that is louder than the noise, and attenuates or mutes the rest.

      iex> format = Situ.AudioFormat.pcm(1000)
      iex> sound = &Situ.AudioBuffer.from_samples(List.duplicate(&1, 20), format)
      iex> feed = [{20_000_000, sound.(50)}, {40_000_000, sound.(9_000)}]
      iex> gated = Situ.to_list(fn p -> p |> Situ.from_enumerable(feed) |> Situ.AudioStream.noise_gate(attack: 0) end)
      iex> Enum.map(gated, &(&1 |> Situ.AudioBuffer.to_samples() |> List.last()))
      [0, 0, 9_000, 9_000]

  The output has buffers of 10 ms, and the gate decides once per buffer. Two levels prevent flickering, and the volume
  changes linearly to avoid clicks.

  #{Options.docs(NoiseGate.options())}
  """
  @spec noise_gate(Stream.t(), keyword()) :: Stream.t()
  def noise_gate(stream, opts \\ []),
    do: stream |> reframe(duration: 10_000_000, tail: :keep) |> Situ.via(NoiseGate, opts)

  @doc """
  Lowers the volume while a stream of booleans is true, for example of a microphone while the loudspeaker is speaking,
  or of music while somebody is talking.

      iex> music = Situ.AudioBuffer.from_samples(List.duplicate(8_000, 1_000), Situ.AudioFormat.pcm(1000))
      iex> t = Situ.Test.start([:music, :talking], &Situ.AudioStream.duck(&1.music, &1.talking))
      iex> Situ.Test.feed(t, :talking, {0, true})
      iex> Situ.Test.advance(t, 2_000_000_000)
      iex> Situ.Test.feed(t, :music, [{1_000_000_000, music}, {2_000_000_000, music}])
      iex> {_time, quiet} = t |> Situ.Test.outputs() |> List.last()
      iex> quiet |> Situ.AudioBuffer.to_samples() |> List.last() < 4_000
      true
      iex> {:ok, _report} = Situ.Test.stop(t)
      iex> :done
      :done

  The stream of booleans has at least one message for each change. Each buffer uses the last boolean that has arrived at
  or before the end of the buffer. In live pipelines a late boolean takes effect when it arrives; in recordings all of
  them arrive in time. The operator delays nothing, and times and lengths do not change. The volume changes linearly to
  avoid clicks.

  #{Options.docs(Ducker.options())}
  """
  @spec duck(Stream.t(), Stream.t(), keyword()) :: Stream.t()
  def duck(stream, while, opts \\ []), do: Situ.via([in: stream, while: while], Ducker, opts)

  @doc """
  Returns the bytes of each buffer.

      iex> sound = Situ.AudioBuffer.from_samples([1, 256], Situ.AudioFormat.pcm(1000))
      iex> Situ.Test.run([sound: [{2_000_000, sound}]], &Situ.AudioStream.to_bytes(&1.sound))
      {:ok, [{2_000_000, <<1, 0, 0, 1>>}]}
  """
  @spec to_bytes(Stream.t(), keyword()) :: Stream.t()
  def to_bytes(stream, opts \\ []),
    do: Operator.attach(stream, "Bytes", {:map, & &1.data}, opts, :binary)

  @doc """
  Builds audio buffers from a stream of binaries, each of which must hold complete frames.

      iex> build = fn s -> Situ.AudioStream.from_bytes(s.bytes, Situ.AudioFormat.pcm(1000)) end
      iex> {:ok, [{time, sound}]} = Situ.Test.run([bytes: [{2_000_000, <<1, 0, 0, 1>>}]], build)
      iex> {time, Situ.AudioBuffer.to_samples(sound)}
      {2_000_000, [1, 256]}
  """
  @spec from_bytes(Stream.t(), AudioFormat.t(), keyword()) :: Stream.t()
  def from_bytes(stream, %AudioFormat{} = format, opts \\ []),
    do: map_buffers(stream, "Sound", &AudioBuffer.new!(format: format, data: &1), opts)

  defp map_buffers(stream, name, fun, opts),
    do: Operator.attach(stream, name, {:map, fun}, opts, AudioBuffer)
end
