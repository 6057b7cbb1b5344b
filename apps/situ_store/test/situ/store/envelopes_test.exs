defmodule Situ.Store.EnvelopesTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Store.Envelopes
  doctest Envelopes

  property "ids increase, creation times never go back, and ordered messages stay unchanged" do
    forall pairs <- list({integer(0, 30), integer(-5, 30)}) do
      messages =
        for {{id, creation}, i} <- Enum.with_index(pairs),
            do: %Situ.Message{
              data: i,
              originating_time: i,
              creation_time: creation,
              sequence_id: id
            }

      {out, last} = Envelopes.make_monotonic(messages, Envelopes.initial_envelope())
      ids = Enum.map(out, & &1.sequence_id)
      creations = Enum.map(out, & &1.creation_time)
      assert ids == Enum.sort(Enum.uniq(ids))
      assert creations == Enum.sort(creations)
      assert Enum.map(out, & &1.data) == Enum.map(messages, & &1.data)

      assert last ==
               if(out == [],
                 do: Envelopes.initial_envelope(),
                 else: {List.last(ids), List.last(creations)}
               )

      sorted? = ids == Enum.map(messages, & &1.sequence_id)

      if sorted? and creations == Enum.map(messages, & &1.creation_time),
        do: assert(out == messages)
    end
  end
end
