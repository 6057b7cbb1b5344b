defmodule Situ.Lifecycle.Errors do
  @moduledoc false
  # The errors that concern the pipeline as a whole.
  alias Situ.Error

  @spec not_running() :: Error.t()
  def not_running do
    Error.new(:not_running, "the pipeline is not running",
      why: "it has ended, or was never started"
    )
  end

  @doc "Builds the error of an operation whose caller ended while the operation waited for others."
  @spec caller_ended() :: Error.t()
  def caller_ended,
    do: Error.new(:caller_ended, "the process that requested the change ended before it began")

  @doc "Builds the error of a checkpoint that a process requests while it still uses another one."
  @spec checkpoint_in_use() :: Error.t()
  def checkpoint_in_use,
    do: Error.new(:busy, "a checkpoint of the pipeline is already running in the same process")

  @doc "Builds the error of a checkpoint that did not begin in time, because other operations were running."
  @spec checkpoint_late() :: Error.t()
  def checkpoint_late do
    Error.new(
      :not_settled,
      "no checkpoint was taken: other changes of the pipeline took too long",
      why: "a checkpoint waits for the changes that were requested before it",
      fix: "allow more time (timeout:); Situ.Pipeline.list_changes/1 shows the changes"
    )
  end

  @spec source_removed() :: Error.t()
  def source_removed,
    do: Error.new(:not_running, "the component that this stream comes from has been removed")

  @spec not_paced() :: Error.t()
  def not_paced do
    Error.new(:unpaced, "the pipeline runs as fast as possible, so its speed cannot be changed",
      why: "with speed: :max, messages do not wait for the clock",
      fix: "start it with a speed, as in replay: [speed: 1.0]"
    )
  end

  @spec unknown_request() :: Error.t()
  def unknown_request do
    Error.new(:unknown_request, "a pipeline does not support this call",
      fix: "use the functions of Situ.Pipeline"
    )
  end

  @doc "Builds the error of a request during which the pipeline raised an exception."
  @spec request_failed(term(), {atom(), term(), list()}) :: Error.t()
  def request_failed(request, {kind, reason, stack}) do
    name = if is_tuple(request), do: elem(request, 0), else: request
    banner = Exception.format_banner(kind, reason, stack)

    Error.new(:request_failed, "the pipeline failed to handle #{inspect(name)}: #{banner}",
      why: "this is a bug in Situ or an invalid argument; the pipeline keeps running",
      fix: "check the arguments; the log contains the full error",
      meta: %{kind: kind, reason: reason, stacktrace: stack}
    )
  end

  @spec unknown_component(term(), String.t() | nil) :: Error.t()
  def unknown_component(path, near) do
    Error.new(:unknown_component, "no component #{inspect(path)}",
      fix: near && "did you mean #{inspect(near)}?"
    )
  end

  @spec pipeline_crashed(term()) :: Error.t()
  def pipeline_crashed(reason),
    do: Error.new(:crashed, "the pipeline process died: #{inspect(reason, limit: 8)}")

  @spec pipeline_abandoned() :: Error.t()
  def pipeline_abandoned do
    Error.new(:abandoned, "the pipeline was abandoned",
      why: "it continues elsewhere; messages in flight were not delivered here"
    )
  end

  @spec request_timeout(term(), timeout()) :: Error.t()
  def request_timeout(request, ms) do
    Error.new(:timeout, "no reply to #{inspect(request, limit: 4)} after #{ms} ms",
      why: "the pipeline is still working on the request",
      fix: "wait longer with timeout:"
    )
  end

  @doc "Builds the error of a component whose process ended unexpectedly."
  @spec component_killed(String.t(), term()) :: Error.t()
  def component_killed(path, reason) do
    Error.new(:component_killed, "#{path} was killed: #{inspect(reason, limit: 8)}",
      meta: %{component: path, reason: reason}
    )
  end

  @doc "Builds the error of a request whose stage was restarted or ended before it replied."
  @spec component_restarted(String.t()) :: Error.t()
  def component_restarted(path) do
    Error.new(:component_restarted, "#{path} ended before it replied",
      why: "its pending requests were lost with its process",
      fix: "send the request again",
      meta: %{component: path}
    )
  end

  @doc "Builds the error of a pipeline whose `build/2` raised an exception, or `{kind, reason}`."
  @spec build_failed(String.t(), term(), list()) :: Error.t()
  def build_failed(_name, %Error{} = error, stack),
    do: %{error | meta: Map.put_new(error.meta, :stacktrace, stack)}

  def build_failed(name, {kind, reason}, stack), do: build_error(name, kind, reason, stack)
  def build_failed(name, exception, stack), do: build_error(name, :error, exception, stack)

  defp build_error(name, kind, reason, stack) do
    Error.new(
      :build_failed,
      "building the pipeline #{name} failed: #{Exception.format_banner(kind, reason, stack)}",
      why: Error.format_location(stack),
      meta: %{kind: kind, reason: reason, stacktrace: stack}
    )
  end
end
