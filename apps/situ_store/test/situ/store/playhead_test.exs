defmodule Situ.Store.PlayheadTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Store.Playhead

  test "a seek past all delivered messages stays in the epoch, and other seeks start a new epoch" do
    head = Playhead.new()
    assert Playhead.claim_time(head, 1_000, Playhead.seek_version(head))
    assert Playhead.seek_to(head, 0, 5_000, false) == 5_000
    assert {2, 5_000, 0} = Playhead.read_view(head)
    # Messages read before the seek must not be delivered.
    refute Playhead.claim_time(head, 2_000, 0)
    assert Playhead.claim_time(head, 6_000, 2)
    # After a seek backward, pipeline time keeps increasing.
    now = Playhead.seek_to(head, 0, 100, false)
    assert now > 6_000
    assert {4, 100, shift} = Playhead.read_view(head)
    assert 100 + shift == now
    # The clock may be later than any message.
    assert Playhead.seek_to(head, now + 10_000, 200, false) > now + 10_000
    # A seek can request a new epoch.
    assert Playhead.seek_to(head, 0, 1_000_000_000, true) != 1_000_000_000 + shift
  end

  property "the pipeline's time never goes back, whatever the seeks" do
    forall steps <- list({one_of([:claim, :seek]), integer(), boolean()}) do
      head = Playhead.new()

      Enum.reduce(steps, -0x7FFFFFFFFFFFFFFF, fn
        {:claim, step, _}, reached ->
          time = max(reached, 0) + abs(step)
          Playhead.claim_time(head, time, Playhead.seek_version(head))
          time

        {:seek, time, anew}, reached ->
          at = Playhead.seek_to(head, 0, time, anew)
          if at <= reached, do: throw({:back, at, reached})
          {_, ^time, shift} = Playhead.read_view(head)
          true = at == time + shift
          reached
      end)

      true
    end
  end
end
