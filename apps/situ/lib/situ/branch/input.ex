defmodule Situ.Branch.Input do
  @moduledoc false
  # Represents the outside of the branch, where its graph begins.
  use Situ.Component, inputs: [], outputs: [out: :any]
end
