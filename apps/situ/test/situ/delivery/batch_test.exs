defmodule Situ.Delivery.BatchTest do
  # A batch with a shared envelope, and the same numbers as columns, behave like the list of their messages.
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Delivery.Batch
  alias Situ.Message

  defp shared(gaps) do
    times = gaps |> Enum.scan(&+/2) |> Enum.map(&(&1 - hd(gaps)))
    base = 1_700_000_000_000_000_000

    %Batch{
      source_id: 7,
      created: base + 1_000,
      first_id: 3,
      last_time: base + List.last(times),
      base: base,
      times: times,
      data: Enum.map(times, &(&1 / 2)),
      size: length(times)
    }
  end

  defp gaps({first, rest}), do: [first | Enum.map(rest, &(&1 + 1))]

  defp columns(batch) do
    {:ok, columns} = Batch.columns(batch)
    columns
  end

  defp unpack(nil), do: []
  defp unpack(batch), do: Batch.messages(batch)

  property "all forms give the same results" do
    forall input <- {integer(0, 3), list(integer(0, 3))} do
      shared = input |> gaps() |> shared()
      messages = Batch.messages(shared)

      assert Enum.map(messages, & &1.sequence_id) == Enum.to_list(3..(2 + length(messages)))
      assert Enum.all?(messages, &match?(%Message{source_id: 7}, &1))

      for fun <- [
            &Batch.size/1,
            &Batch.first_time/1,
            &Batch.last_time/1,
            &Batch.last_stamp/1,
            &Batch.data/1,
            &Batch.times/1,
            &Batch.base/1,
            &Batch.messages/1
          ],
          form <- [shared, columns(shared), columns(messages)],
          do: assert(fun.(form) === fun.(messages))

      assert Batch.first_data(shared) == Batch.first_data(messages)
    end
  end

  property "splitting and popping lose nothing and keep the envelopes" do
    forall {input, n, time} <-
             {{integer(0, 3), list(integer(0, 3))}, integer(1, 9), integer(-1, 20)} do
      shared = input |> gaps() |> shared()
      messages = Batch.messages(shared)
      final = shared.base + time

      for batch <- [shared, messages, columns(shared), columns(messages)] do
        {taken, rest} = Batch.split(batch, n)
        assert unpack(taken) == Enum.take(messages, n)
        assert unpack(rest) == Enum.drop(messages, n)
        assert Batch.last_time(taken) == List.last(unpack(taken)).originating_time
        assert {^batch, nil} = Batch.split(batch, :infinity)

        {kept, late} = Batch.split_after(batch, final)
        assert unpack(kept) == Enum.filter(messages, &(&1.originating_time <= final))
        assert unpack(kept) ++ unpack(late) == messages

        {first, rest} = Batch.pop(batch)
        assert [first | unpack(rest)] == messages
      end
    end
  end
end
