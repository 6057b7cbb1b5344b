defmodule Situ.Graph.Edge do
  @moduledoc false
  # A connection: `from` is `{vertex, output}`, `to` is `{vertex, input}`, and `policy` is the delivery policy of its
  # queue.

  @enforce_keys [:id, :from, :to, :policy]
  defstruct [:id, :from, :to, :policy, explicit: false]

  @type t :: %__MODULE__{
          id: pos_integer(),
          from: {pos_integer(), atom()},
          to: {pos_integer(), atom()},
          policy: Situ.Delivery.t(),
          explicit: boolean()
        }
end
