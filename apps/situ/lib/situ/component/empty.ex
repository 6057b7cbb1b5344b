defmodule Situ.Component.Empty do
  @moduledoc false
  # A component without inputs or outputs that completes immediately; the smallest possible component.
  use Situ.Component

  @impl true
  def handle_start(context, state), do: {[{:complete, context.start_time}], state}
end
