defmodule Situ.Operators.StatisticsTest do
  # Statistics and filter cases that the conformance files do not cover, such as unusual numbers and bad input.
  use ExUnit.Case, async: true

  alias Situ.{Reproducible, Time}

  @moduletag :capture_log

  defp run(inputs, build, opts \\ []) do
    {:ok, outputs} = Situ.Test.run(inputs, build, opts)
    outputs
  end

  describe "statistics" do
    test "mix integers, floats, NaN and nil" do
      inputs = [n: [{0, 1}, {1, 2.5}, {2, nil}, {3, :nan}]]
      assert run(inputs, &Situ.sum(&1.n)) == [{0, 1}, {1, 3.5}, {2, 3.5}, {3, :nan}]
      assert run(inputs, &Situ.max(&1.n)) == [{0, 1}, {1, 2.5}, {2, 2.5}, {3, :nan}]
    end

    test "over an empty list return an error that suggests a fix" do
      assert {:error, %{code: :empty_list, fix: fix}} =
               Situ.Test.run([n: [{0, []}]], &Situ.average(&1.n, over: :list))

      assert fix =~ "nullable: true"
      assert run([n: [{0, []}]], &Situ.average(&1.n, over: :list, nullable: true)) == [{0, nil}]
      assert run([n: [{0, []}]], &Situ.sum(&1.n, over: :list)) == [{0, 0}]
    end

    test "over non-numbers return an error" do
      assert {:error, %{code: :not_a_number}} = Situ.Test.run([n: [{0, "1"}]], &Situ.sum(&1.n))
    end

    test "return infinity instead of overflowing" do
      assert run([n: [{0, 1.0e308}, {1, 1.0e308}]], &Situ.sum(&1.n)) == [
               {0, 1.0e308},
               {1, :infinity}
             ]
    end

    test "compare with a function" do
      dates = [~D[2024-05-01], ~D[2024-02-28], ~D[2024-12-03]]
      inputs = [d: Enum.with_index(dates, fn d, i -> {i, d} end)]
      earlier = &(Date.compare(&1, &2) != :gt)
      assert List.last(run(inputs, &Situ.min(&1.d, compare: earlier))) == {2, ~D[2024-02-28]}
    end

    test "linear interpolation and filters handle NaN, infinities and nil as statistics do" do
      inputs = [
        n: [{0, 1}, {10, 3}, {20, :nan}, {30, nil}, {40, 2}, {50, :infinity}, {60, 1.0e308}]
      ]

      ticks = [t: Enum.map(1..11, &{&1 * 5, :tick})]
      line = &Situ.sample(&1.n, &1.t, Reproducible.linear())

      assert Enum.map(run(inputs ++ ticks, line), &elem(&1, 1)) ==
               [2.0, 3, :nan, :nan, nil, nil, nil, 2, :infinity, :infinity, :nan]

      assert Enum.map(run(inputs, &Situ.denoise(&1.n, order: 3)), &elem(&1, 1)) ==
               [1, 2.0, :nan, nil, :nan, :nan, 1.0e308]

      assert [1, _, :nan, nil, :nan, :nan, :nan] =
               Enum.map(run(inputs, &Situ.one_euro(&1.n)), &elem(&1, 1))
    end

    test "a finite filter forgets NaN after its taps, and an infinite filter never does" do
      values = [1.0, :nan] ++ List.duplicate(1.0, 40)
      inputs = [n: Enum.with_index(values, &{&2 * 10_000_000, &1})]
      lowpass = fn opts -> &Situ.lowpass(&1.n, [rate: 100] ++ [cutoff: 10, order: 8] ++ opts) end
      taps = Situ.Filter.Fir.design_taps(:lowpass, 100, [10], 8)

      {strange, plain} = inputs |> run(lowpass.([])) |> Enum.map(&elem(&1, 1)) |> Enum.split(10)
      assert [first | nans] = strange
      assert first == hd(taps)
      assert Enum.all?(nans, &(&1 == :nan)) and length(nans) == length(taps)
      assert length(plain) == 32
      assert Enum.all?(plain, &(abs(&1 - 1.0) < 1.0e-9))

      assert [first | nans] =
               inputs |> run(lowpass.(response: :infinite)) |> Enum.map(&elem(&1, 1))

      assert is_float(first)
      assert Enum.all?(nans, &(&1 == :nan))
    end

    test "filters refuse non-numbers and return infinity on overflow" do
      for filter <- [
            &Situ.denoise(&1.n),
            &Situ.one_euro(&1.n),
            &Situ.lowpass(&1.n, rate: 100, cutoff: 10)
          ] do
        inputs = [n: [{0, "1"}, {20_000_000, "2"}]]
        assert {:error, %{code: :not_a_number}} = Situ.Test.run(inputs, filter)
      end

      filter = Situ.Filter.Fir.new(:highpass, 100, [10], 8)
      # Each value is as large as possible, with the sign that adds up.
      worst = for tap <- Enum.reverse(filter.taps), do: if(tap < 0, do: -1.79e308, else: 1.79e308)
      step = fn sample, {_, filter} -> Situ.Filter.Fir.step(filter, sample) end
      assert {:infinity, filter} = Enum.reduce(worst, {nil, filter}, step)
      assert {out, _} = Enum.reduce(1..9, {nil, filter}, fn _, state -> step.(0.0, state) end)
      assert out == 0.0
    end

    test "logarithms of zero and negative numbers are defined" do
      assert run([n: [{0, 8}, {1, 0}, {2, -1}]], &Situ.log(&1.n, base: 2)) ==
               [{0, 3.0}, {1, :neg_infinity}, {2, :nan}]
    end
  end

  describe "filters" do
    # Mixes 2 Hz and 30 Hz tones, sampled at 200 Hz for 2 s.
    defp tones do
      for n <- 0..399 do
        t = n / 200
        {n * Time.ms(5), {:math.sin(2 * :math.pi() * 2 * t), :math.sin(2 * :math.pi() * 30 * t)}}
      end
    end

    defp power(outputs),
      do: Enum.sum(for {t, v} <- outputs, t > Time.ms(500), do: v * v) / length(outputs)

    test "pass the wanted band and stop the rest" do
      low = [s: for({t, {low, _}} <- tones(), do: {t, low})]
      high = [s: for({t, {_, high}} <- tones(), do: {t, high})]

      for response <- [:finite, :infinite] do
        lowpass = &Situ.lowpass(&1.s, rate: 200, cutoff: 8, response: response)
        highpass = &Situ.highpass(&1.s, rate: 200, cutoff: 15, response: response)
        assert power(run(low, lowpass)) > 50 * power(run(high, lowpass))
        assert power(run(high, highpass)) > 50 * power(run(low, highpass))
        bandpass = &Situ.bandpass(&1.s, rate: 200, band: {20, 40}, response: response)
        assert power(run(high, bandpass)) > 20 * power(run(low, bandpass))
        bandstop = &Situ.bandstop(&1.s, rate: 200, band: {20, 45}, response: response, order: 64)
        assert power(run(low, bandstop)) > 20 * power(run(high, bandstop))
      end
    end

    test "refuse band edges that do not fit the rate" do
      Situ.Pipeline.run(fn p ->
        s = Situ.return(p, 1.0)

        assert_raise ArgumentError, ~r/half the rate/, fn ->
          Situ.lowpass(s, rate: 100, cutoff: 60)
        end

        assert_raise ArgumentError, fn -> Situ.bandpass(s, rate: 100, band: {30, 20}) end
        assert_raise Situ.Error, ~r/required/, fn -> Situ.lowpass(s, rate: 100) end
      end)
    end

    test "denoise/2 removes a single outlier" do
      inputs = [s: Enum.with_index([1, 1, 99, 1, 1], &{&2, &1})]

      assert Enum.map(run(inputs, &Situ.denoise(&1.s, order: 3)), &elem(&1, 1)) == [
               1,
               1.0,
               1,
               1,
               1
             ]
    end
  end
end
