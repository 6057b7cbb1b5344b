defmodule Situ.Branch.Inlet do
  @moduledoc false
  # Stands for the world outside, where the branch's graph begins.
  use Situ.Component, inputs: [], outputs: [out: :any]
end
