defmodule Situ.Fixture.Silent do
  # A source that never announces its end.
  use Situ.Component, outputs: [out: :any]
end
