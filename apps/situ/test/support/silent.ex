defmodule Situ.Fixture.Silent do
  # A source that never says when it ends.
  use Situ.Component, outputs: [out: :any]
end
