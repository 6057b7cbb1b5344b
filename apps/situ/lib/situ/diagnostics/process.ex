defmodule Situ.Diagnostics.Process do
  @moduledoc """
  One process of a pipeline in a `Situ.Diagnostics.Snapshot`: `number`, `pid` (a string, `""` once it has ended),
  `nodes` (paths of its nodes, in order), `memory` (bytes), `mailbox` (messages waiting), `reductions` (total),
  `status` (`"waiting"`, `"running"` ...), `busy_in` (the function that it is executing, as a string; shows where a
  component is stuck).
  """
  defstruct number: 0,
            pid: "",
            nodes: [],
            memory: 0,
            mailbox: 0,
            reductions: 0,
            status: "",
            busy_in: ""

  @type t :: %__MODULE__{
          number: pos_integer(),
          pid: String.t(),
          nodes: [String.t()],
          memory: non_neg_integer(),
          mailbox: non_neg_integer(),
          reductions: non_neg_integer(),
          status: String.t(),
          busy_in: String.t()
        }
end
