defmodule Situ.Store.PlayheadTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Store.Playhead

  test "a seek beyond what was handed out stays in the epoch, any other begins a new one" do
    head = Playhead.new()
    assert Playhead.claim(head, 1_000, Playhead.version(head))
    assert Playhead.seek(head, 0, 5_000, false) == 5_000
    assert {2, 5_000, 0} = Playhead.view(head)
    # Messages read before the seek must not be handed out.
    refute Playhead.claim(head, 2_000, 0)
    assert Playhead.claim(head, 6_000, 2)
    # Back: pipeline time goes on.
    now = Playhead.seek(head, 0, 100, false)
    assert now > 6_000
    assert {4, 100, shift} = Playhead.view(head)
    assert 100 + shift == now
    # The clock may be further than any message.
    assert Playhead.seek(head, now + 10_000, 200, false) > now + 10_000
    # A new epoch where one is asked for.
    assert Playhead.seek(head, 0, 1_000_000_000, true) != 1_000_000_000 + shift
  end

  property "the pipeline's time never goes back, however it is sought" do
    forall steps <- list({one_of([:claim, :seek]), integer(), boolean()}) do
      head = Playhead.new()

      Enum.reduce(steps, -0x7FFFFFFFFFFFFFFF, fn
        {:claim, step, _}, reached ->
          time = max(reached, 0) + abs(step)
          Playhead.claim(head, time, Playhead.version(head))
          time

        {:seek, time, anew}, reached ->
          at = Playhead.seek(head, 0, time, anew)
          if at <= reached, do: throw({:back, at, reached})
          {_, ^time, shift} = Playhead.view(head)
          true = at == time + shift
          reached
      end)

      true
    end
  end
end
