defmodule Situ.Link.Wire.ClockEstimateTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Link.Wire.ClockEstimate
  doctest ClockEstimate

  @second 1_000_000_000

  # Round trips once a second over a link whose two directions take `base` and up to `noise` ns more, to a clock that
  # is `offset` ahead at our time 0 and gains `drift`.
  defp trips(n, offset, drift, base, delays) do
    for {{there, back}, i} <- Enum.with_index(Enum.take(Stream.cycle(delays), n)) do
      t0 = i * @second
      arrives = t0 + base + there
      leaves = arrives + 10_000
      t3 = leaves + base + back
      theirs = fn ours -> round(ours + offset + drift * ours) end
      {t0, theirs.(arrives), theirs.(leaves), t3}
    end
  end

  defp estimate(trips),
    do: Enum.reduce(trips, ClockEstimate.new(), &ClockEstimate.add_round_trip(&2, &1))

  property "the offset is as accurate as the fastest round trip allows, whatever the noise",
    numtests: 60 do
    forall {offset, base, delays} <-
             {integer(-1_000_000_000_000, 1_000_000_000_000), integer(1_000, 50_000_000),
              nonempty_list({integer(0, 30_000_000), integer(0, 30_000_000)})} do
      trips = trips(6, offset, 0.0, base, delays)
      clock = estimate(trips)
      now = 6 * @second
      error = abs(ClockEstimate.offset_at(clock, now) - offset)
      assert error <= ClockEstimate.uncertainty_at(clock, now) + 2
    end
  end

  test "estimates drift over minutes and predicts with it" do
    delays = for i <- 1..40, do: {rem(i * 7919, 400_000), rem(i * 104_729, 400_000)}

    for drift <- [40.0e-6, -120.0e-6] do
      clock = estimate(trips(240, 5 * @second, drift, 200_000, delays))
      now = 300 * @second
      assert_in_delta clock.drift, drift, 1.0e-6
      assert_in_delta ClockEstimate.offset_at(clock, now), 5 * @second + drift * now, 250_000

      ours = 299 * @second
      theirs = round(ours + 5 * @second + drift * ours)
      assert_in_delta ClockEstimate.to_local_time(clock, theirs), ours, 250_000
    end
  end

  test "follows a clock change after three round trips" do
    before = estimate(trips(30, 0, 0.0, 100_000, [{0, 0}]))

    later =
      for {t0, t1, t2, t3} <- Enum.drop(trips(40, 7 * @second, 0.0, 100_000, [{0, 0}]), 30),
          do: {t0, t1, t2, t3}

    clock = Enum.reduce(Enum.take(later, 3), before, &ClockEstimate.add_round_trip(&2, &1))
    assert_in_delta ClockEstimate.offset_at(clock, 33 * @second), 7 * @second, 1_000_000
  end

  test "ignores impossible round trips" do
    clock = estimate(trips(3, 0, 0.0, 1_000, [{0, 0}]))
    assert ClockEstimate.add_round_trip(clock, {10, 5, 4, 20}) == clock
    assert ClockEstimate.add_round_trip(clock, {10, 5, 6, 9}) == clock
    assert ClockEstimate.uncertainty_at(ClockEstimate.new(), 0) == nil
    assert ClockEstimate.to_local_time(ClockEstimate.new(), 7) == 7
  end
end
