defmodule Situ.AudioStream.TimesTest do
  # Every operator must keep the time of every sample. Each sample's value is its index, so its expected time is
  # known.
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.{AudioBuffer, AudioFormat, AudioOps}

  @rate 8000
  @format AudioFormat.pcm(@rate, 1, :s32)

  # Buffers of the given sizes, in which sample i has the value i.
  defp feed(sizes, format \\ @format) do
    {feed, _} =
      Enum.map_reduce(sizes, 0, fn size, done ->
        values = if size == 0, do: [], else: Enum.to_list(done..(done + size - 1))
        buffer = AudioBuffer.from_samples(values, format)
        {{AudioFormat.frames_to_ns(format, done + size), buffer}, done + size}
      end)

    Enum.reject(feed, fn {_, buffer} -> buffer.data == "" end)
  end

  defp run(feed, fun),
    do: Situ.to_list(fn p -> p |> Situ.from_enumerable(feed) |> fun.() end, times: true)

  property "reframing keeps every sample and its time" do
    forall {sizes, frames} <- {nonempty_list(integer(0, 50)), integer(1, 40)} do
      out = run(feed(sizes), &Situ.AudioStream.reframe(&1, frames: frames))
      whole = div(Enum.sum(sizes), frames)

      Enum.flat_map(out, fn {_, b} -> AudioBuffer.to_samples(b) end) ==
        Enum.take(Stream.iterate(0, &(&1 + 1)), whole * frames) and
        Enum.map(out, &elem(&1, 0)) ==
          for(k <- 1..whole//1, do: AudioFormat.frames_to_ns(@rate, k * frames))
    end
  end

  test "reframing with a hop overlaps frames and can keep the tail" do
    feed = feed([7, 4])
    out = run(feed, &Situ.AudioStream.reframe(&1, frames: 4, hop: 2))
    assert for({_, b} <- out, do: hd(AudioBuffer.to_samples(b))) == [0, 2, 4, 6]
    assert List.last(out) |> elem(0) == AudioFormat.frames_to_ns(@rate, 10)

    assert {_, last} =
             feed |> run(&Situ.AudioStream.reframe(&1, frames: 4, tail: :keep)) |> List.last()

    assert AudioBuffer.to_samples(last) == [8, 9, 10]

    assert {at, last} =
             feed |> run(&Situ.AudioStream.reframe(&1, frames: 4, tail: :pad)) |> List.last()

    assert AudioBuffer.to_samples(last) == [8, 9, 10, 0]
    assert at == AudioFormat.frames_to_ns(@rate, 11)
  end

  property "resampling gives the same audio at the same times for any buffer sizes" do
    forall sizes <- nonempty_list(integer(1, 400)) do
      format = AudioFormat.pcm(@rate, 1, :f32)
      total = Enum.sum(sizes)
      {whole, parts} = {resampled([total], format), resampled(sizes, format)}
      bytes = fn out -> Enum.map_join(out, fn {_, b} -> b.data end) end
      last = fn out -> out |> List.last() |> elem(0) end

      bytes.(whole) == bytes.(parts) and last.(whole) == last.(parts) and exact?(parts, 16_000)
    end
  end

  defp resampled(sizes, format),
    do: run(feed(sizes, format), &Situ.AudioStream.resample(&1, 16_000))

  # Each buffer ends at the number of frames so far.
  defp exact?(out, rate) do
    {_, right?} =
      Enum.reduce(out, {0, true}, fn {time, buffer}, {done, right?} ->
        done = done + AudioBuffer.frame_count(buffer)
        {done, right? and abs(time - AudioFormat.frames_to_ns(rate, done)) <= 1}
      end)

    right?
  end

  test "a resampled tone keeps its position in time, with 60 dB signal-to-noise ratio" do
    sine = fn rate, n ->
      for i <- 0..(n - 1), do: 0.5 * :math.sin(2 * :math.pi() * 440 * i / rate)
    end

    format = AudioFormat.pcm(48_000, 1, :f32)

    {:ok, out} =
      AudioOps.resample(AudioBuffer.from_samples(sine.(48_000, 24_000), format), 16_000)

    assert AudioBuffer.frame_count(out) == 8000

    pairs =
      out |> AudioBuffer.to_samples() |> Enum.zip(sine.(16_000, 8000)) |> Enum.slice(200, 7600)

    noise = Enum.sum(for {a, b} <- pairs, do: (a - b) * (a - b))
    signal = Enum.sum(for {_, b} <- pairs, do: b * b)
    assert 10 * :math.log10(signal / noise) > 60
  end

  test "u8 and s24 audio is resampled and keeps its sample type" do
    for sample <- [:u8, :s24] do
      buffer = AudioBuffer.build_silence(AudioFormat.pcm(48_000, 2, sample), 480)
      assert {:ok, out} = AudioOps.resample(buffer, 16_000)
      assert out.format == AudioFormat.pcm(16_000, 2, sample)
      assert out == AudioBuffer.build_silence(out.format, 160)
    end
  end

  test "follows a format change in mid-stream" do
    a = AudioBuffer.build_silence(AudioFormat.pcm(8000), 800)
    b = AudioBuffer.build_silence(AudioFormat.pcm(32_000), 3200)
    out = run([{100_000_000, a}, {200_000_000, b}], &Situ.AudioStream.resample(&1, 16_000))
    assert out |> Enum.map(&AudioBuffer.frame_count(elem(&1, 1))) |> Enum.sum() == 3200
    assert out |> List.last() |> elem(0) == 200_000_000
  end

  describe "streamline" do
    test "concatenate ignores gaps" do
      feed = [{1_000_000, samples(8)}, {9_000_000, samples(8)}]

      assert [{1_000_000, _}, {2_000_000, _}] =
               run(feed, &Situ.AudioStream.streamline(&1, method: :concatenate))
    end

    test "pleat pads or cuts each buffer to the time since the previous one" do
      feed = [{1_000_000, samples(8)}, {3_000_000, samples(8)}, {3_500_000, samples(8)}]
      out = run(feed, &Situ.AudioStream.streamline(&1, method: :pleat))
      assert [{1_000_000, a}, {3_000_000, b}, {3_500_000, c}] = out
      assert Enum.map([a, b, c], &AudioBuffer.frame_count/1) == [8, 16, 4]
      assert AudioBuffer.to_samples(b) == List.duplicate(5, 8) ++ List.duplicate(0, 8)
    end

    test "unpleat pads and cuts when times have drifted" do
      feed = [
        {1_000_000, samples(8)},
        {2_100_000, samples(8)},
        {4_000_000, samples(8)},
        {4_500_000, samples(8)}
      ]

      opts = [method: :unpleat, max_offset: 200_000]
      out = run(feed, &Situ.AudioStream.streamline(&1, opts))
      assert [{1_000_000, _}, {2_000_000, _}, {4_000_000, late}, {4_500_000, early}] = out
      assert AudioBuffer.to_samples(late) == List.duplicate(0, 8) ++ List.duplicate(5, 8)
      assert AudioBuffer.frame_count(early) == 4
    end
  end

  defp samples(n), do: AudioBuffer.from_samples(List.duplicate(5, n), @format)

  # A clock that is set while a device is running jumps by decades; filling that gap with silence would take
  # terabytes.
  @jump 315_360_000_000_000_000

  @tag :capture_log
  test "a jump in time is an error instead of endless silence" do
    feed = [{1_000_000, samples(8)}, {@jump, samples(8)}]

    for method <- [:pleat, :unpleat] do
      build = fn p ->
        p |> Situ.from_enumerable(feed) |> Situ.AudioStream.streamline(method: method)
      end

      assert {:error, %{code: :gap_too_long} = error} = Situ.collect(build)
      assert Exception.message(error) =~ "3649 d 23 h"
    end

    build = fn p ->
      Situ.AudioStream.mix(
        Situ.from_enumerable(p, feed),
        Situ.from_enumerable(p, [{@jump, samples(8)}])
      )
    end

    assert {:error, %{code: :gap_too_long}} = Situ.collect(build)
  end

  @tag :capture_log
  test "streamlining requires a single format" do
    feed = [
      {1_000_000, samples(8)},
      {2_000_000, AudioBuffer.build_silence(AudioFormat.pcm(48_000), 48)}
    ]

    build = fn p -> p |> Situ.from_enumerable(feed) |> Situ.AudioStream.streamline() end
    assert {:error, %{code: :bad_audio} = error} = Situ.collect(build)
    assert Exception.message(error) =~ "48000 Hz"
  end

  property "a mix contains the sum of all inputs at every moment" do
    track = nonempty_list({integer(1, 12), integer(1, 9)})

    forall {left, right} <- {track, track} do
      {left, right} = {placed(left, 1), placed(right, 100)}

      out =
        Situ.to_list(
          fn p ->
            Situ.AudioStream.mix(Situ.from_enumerable(p, left), Situ.from_enumerable(p, right))
          end,
          times: true
        )

      {start, samples} = heard(out)
      expected = Map.merge(track(left), track(right), fn _at, a, b -> a + b end)
      first = Enum.min(Map.keys(expected))

      start == first and
        samples == for(i <- first..Enum.max(Map.keys(expected)), do: Map.get(expected, i, 0))
    end
  end

  # Buffers at 1 kHz, each ending this much later than the previous one, with gaps and overlaps. Samples are `scale`.
  defp placed(track, scale) do
    {feed, _} =
      Enum.map_reduce(track, 20, fn {later, frames}, time ->
        buffer = AudioBuffer.from_samples(List.duplicate(scale, frames), AudioFormat.pcm(1000))
        {{(time + later) * 1_000_000, buffer}, time + later}
      end)

    feed
  end

  # The track's samples by millisecond; where buffers overlap, the first samples count.
  defp track(feed) do
    for {time, buffer} <- feed,
        {value, i} <- Enum.with_index(AudioBuffer.to_samples(buffer)),
        reduce: %{} do
      track ->
        at = div(time, 1_000_000) - AudioBuffer.frame_count(buffer) + i

        if at > Enum.max(Map.keys(track), fn -> -1 end),
          do: Map.put(track, at, value),
          else: track
    end
  end

  # Joins contiguous buffers into their start time and all samples.
  defp heard([{time, first} | _] = out) do
    samples = Enum.flat_map(out, fn {_, buffer} -> AudioBuffer.to_samples(buffer) end)
    {div(time, 1_000_000) - AudioBuffer.frame_count(first), samples}
  end

  test "mixing adds audio by time, across gaps" do
    format = AudioFormat.pcm(1000)
    b = &AudioBuffer.from_samples(&1, format)
    left = [{2_000_000, b.([1, 1])}, {6_000_000, b.([1])}]
    right = [{3_000_000, b.([10, 10])}, {4_000_000, b.([10])}]

    out =
      Situ.to_list(
        fn p ->
          Situ.AudioStream.mix(Situ.from_enumerable(p, left), Situ.from_enumerable(p, right),
            other_gain: 2
          )
        end,
        times: true
      )

    assert Enum.flat_map(out, fn {_, b} -> AudioBuffer.to_samples(b) end) == [1, 21, 20, 20, 0, 1]
    assert out |> List.last() |> elem(0) == 6_000_000
  end

  property "reformatting to a wider type and back is exact" do
    forall {bytes, sample} <- {binary(), one_of([:u8, :s16, :s24, :s32])} do
      format = AudioFormat.pcm(8000, 1, sample)
      size = AudioFormat.bytes_per_frame(format)

      buffer =
        AudioBuffer.new!(
          format: format,
          data: binary_part(bytes, 0, div(byte_size(bytes), size) * size)
        )

      wide = AudioOps.reformat!(buffer, sample: :f64, channels: 2)
      AudioOps.reformat!(wide, sample: sample, channels: 1) == buffer
    end
  end
end
