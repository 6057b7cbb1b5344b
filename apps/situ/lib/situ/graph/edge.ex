defmodule Situ.Graph.Edge do
  @moduledoc """
  One connection: `from` = `{vertex, output}`, `to` = `{vertex, input}`, and the policy of the queue in between.
  """
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
