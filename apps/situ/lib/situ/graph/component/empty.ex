defmodule Situ.Component.Empty do
  @moduledoc "A component without inputs and outputs that is done at once: the smallest one there is."
  use Situ.Component

  @impl true
  def handle_start(context, state), do: {[{:complete, context.start_time}], state}
end
