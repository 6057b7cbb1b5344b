defmodule Situ.Link.Wire.QuotaTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Link.Wire.Quota
  doctest Quota

  property "a sender that waits as asked exceeds the rate by at most a tenth of a second" do
    forall {rate, sizes} <- {integer(1_000, 1_000_000), list(integer(1, 50_000))} do
      quota = Quota.new({:bytes_per_second, rate})
      now = -5_000_000_000

      finished =
        Enum.reduce(sizes, now, fn size, now -> now + Quota.charge_sent(quota, size, 1, now) end)

      least = Enum.sum(sizes) * 1.0e9 / rate - 100_000_000
      assert finished - now >= least - length(sizes) - 1
      assert finished - now <= max(least, 0) + length(sizes) + 1
    end
  end

  test "the stricter of two limits applies" do
    quota = Quota.new([{:bytes_per_second, 1_000_000_000}, {:messages_per_second, 10}])
    assert Quota.charge_sent(quota, 10, 2, 0) == 100_000_000
  end

  test "chunks last 50 ms" do
    assert Quota.segment_size(Quota.new({:bytes_per_second, 1_000_000}), 4_000_000) == 50_000
    assert Quota.segment_size(Quota.new({:bytes_per_second, 10}), 4_000_000) == 4_096
    assert Quota.segment_size(Quota.new(nil), 4_000_000) == 4_000_000
  end
end
