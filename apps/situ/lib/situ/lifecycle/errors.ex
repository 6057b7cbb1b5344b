defmodule Situ.Lifecycle.Errors do
  @moduledoc false
  # The errors of a pipeline as a whole.
  alias Situ.Error

  @spec not_running() :: Error.t()
  def not_running do
    Error.new(:not_running, "the pipeline is not running",
      why: "it has ended, or was never started"
    )
  end

  @spec stream_removed() :: Error.t()
  def stream_removed,
    do: Error.new(:not_running, "the component that this stream comes from has been removed")

  @spec unpaced() :: Error.t()
  def unpaced do
    Error.new(:unpaced, "the pipeline runs as fast as it can: there is no speed to change",
      why: "with speed: :max no message waits for the clock",
      fix: "start it with a speed, as in replay: [speed: 1.0]"
    )
  end

  @spec unknown_request() :: Error.t()
  def unknown_request do
    Error.new(:unknown_request, "a pipeline has no answer to this call",
      fix: "use the functions of Situ.Pipeline"
    )
  end

  @doc "The pipeline raised while it answered a request."
  @spec request_failed(term(), {atom(), term(), list()}) :: Error.t()
  def request_failed(request, {kind, reason, stack}) do
    name = if is_tuple(request), do: elem(request, 0), else: request
    banner = Exception.format_banner(kind, reason, stack)

    Error.new(:request_failed, "the pipeline could not answer #{inspect(name)}: #{banner}",
      why: "this is a fault of Situ, or of an argument; the pipeline keeps running as before",
      fix: "check the arguments; the log has the whole error",
      meta: %{kind: kind, reason: reason, stacktrace: stack}
    )
  end

  @spec unknown_component(term(), String.t() | nil) :: Error.t()
  def unknown_component(path, near) do
    Error.new(:unknown_component, "no component #{inspect(path)}",
      fix: near && "did you mean #{inspect(near)}?"
    )
  end

  @spec crashed(term()) :: Error.t()
  def crashed(reason),
    do: Error.new(:crashed, "the pipeline process died: #{inspect(reason, limit: 8)}")

  @spec abandoned() :: Error.t()
  def abandoned do
    Error.new(:abandoned, "the pipeline was given up",
      why: "what it did goes on elsewhere: messages under way were not delivered here"
    )
  end

  @spec timeout(term(), timeout()) :: Error.t()
  def timeout(request, ms) do
    Error.new(:timeout, "no answer to #{inspect(request, limit: 4)} after #{ms} ms",
      why: "the pipeline still works on the request",
      fix: "wait longer with timeout:"
    )
  end

  @doc "A component's process ended without having been asked to."
  @spec killed(String.t(), term()) :: Error.t()
  def killed(path, reason) do
    Error.new(:component_killed, "#{path} was killed: #{inspect(reason, limit: 8)}",
      meta: %{component: path, reason: reason}
    )
  end

  @doc "A stage that owed an answer was restarted, or is gone."
  @spec interrupted(String.t()) :: Error.t()
  def interrupted(path) do
    Error.new(:component_restarted, "#{path} ended before it answered",
      why: "its pending requests were lost with it",
      fix: "ask again",
      meta: %{component: path}
    )
  end

  @spec build_failed(term(), term(), list()) :: Error.t()
  def build_failed(_spec, %Error{} = error, stack),
    do: %{error | meta: Map.put_new(error.meta, :stacktrace, stack)}

  def build_failed(spec, {kind, reason}, stack), do: failed(spec, kind, reason, stack)
  def build_failed(spec, exception, stack), do: failed(spec, :error, exception, stack)

  defp failed(spec, kind, reason, stack) do
    Error.new(
      :build_failed,
      "building #{inspect(spec)} failed: #{Exception.format_banner(kind, reason, stack)}",
      meta: %{kind: kind, reason: reason, stacktrace: stack}
    )
  end
end
