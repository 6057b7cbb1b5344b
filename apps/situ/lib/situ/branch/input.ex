defmodule Situ.Branch.Input do
  @moduledoc false
  # The inlet of a branch, where its graph begins.
  use Situ.Component, inputs: [], outputs: [out: :any]
end
