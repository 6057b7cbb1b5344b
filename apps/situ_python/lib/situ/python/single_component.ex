defmodule Situ.Python.SingleComponent do
  @moduledoc false
  # A Python component with one input. It takes several messages in one call, which would change the order among the
  # messages of several inputs.
  @behaviour Situ.Component
  alias Situ.Python.Component

  @impl true
  defdelegate inputs, to: Component
  @impl true
  defdelegate outputs, to: Component
  @impl true
  defdelegate options, to: Component
  @impl true
  defdelegate init(opts), to: Component
  @impl true
  defdelegate handle_start(context, state), to: Component
  @impl true
  defdelegate handle_message(input, message, context, state), to: Component
  @impl true
  defdelegate handle_messages(input, messages, context, state), to: Component, as: :handle_batch
  @impl true
  defdelegate handle_closed(input, time, context, state), to: Component
  @impl true
  defdelegate handle_info(message, context, state), to: Component
  @impl true
  defdelegate handle_stop(time, context, state), to: Component
  @impl true
  defdelegate terminate(reason, state), to: Component
  @impl true
  defdelegate snapshot(state), to: Component
  @impl true
  defdelegate restore(data, fresh), to: Component
  @impl true
  defdelegate describe(state), to: Component
end
