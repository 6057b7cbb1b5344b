defmodule Situ.Diagnostics.Process do
  @moduledoc false
  # One process of a pipeline. `Situ.Diagnostics.Snapshot` documents the fields.

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
