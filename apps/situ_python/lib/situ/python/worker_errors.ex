defmodule Situ.Python.WorkerErrors do
  @moduledoc false
  # The errors of a worker: why it could not be started, or why it has ended. The component adds its path and the
  # message that was being handled.
  alias Situ.Error

  @doc "The system lacks the resources for a worker."
  @spec start_error(String.t()) :: Error.t()
  def start_error(why) do
    Error.new(:python_not_started, "the Python worker cannot be started",
      why: why,
      fix: "free memory or disk space, or lower shared_memory:"
    )
  end

  @doc "The options are not plain data."
  @spec option_error() :: Error.t()
  def option_error do
    Error.new(:bad_python_options, "the options cannot be sent to Python",
      why: "they contain functions, processes or references",
      fix: "use numbers, strings, booleans, lists and maps in options:"
    )
  end

  @doc "Python has reported why it cannot start the component."
  @spec not_started_error(map()) :: Error.t()
  def not_started_error(term) do
    [why, fix] = for key <- ["why", "fix"], do: if(is_binary(term[key]), do: term[key])
    Error.new(start_code(term["code"]), term["what"], why: why, fix: fix)
  end

  defp start_code("no_python_class"), do: :no_python_class
  defp start_code("no_python_module"), do: :no_python_module
  defp start_code("bad_component"), do: :bad_component
  defp start_code(_other), do: :python_failed

  @doc "A frame is invalid."
  @spec protocol_error() :: Error.t()
  def protocol_error do
    Error.new(:bad_python_frame, "the Python worker sent invalid data",
      fix: "the component must not use the socket that connects it to Situ"
    )
  end

  @doc "The program has ended, for a reason that may be unknown, with these last lines of its output."
  @spec ended_error(String.t() | nil, String.t()) :: Error.t()
  def ended_error(reason, lines) do
    why = reason || "it closed its connection"

    Error.new(:python_ended, "the Python worker has ended",
      why: if(lines == "", do: why, else: "#{why}; its last output was:\n#{lines}"),
      fix: "correct the component, or restart it with on_error: :restart"
    )
  end

  @doc "A message took longer than `timeout` ms."
  @spec late_error(pos_integer()) :: Error.t()
  def late_error(timeout) do
    Error.new(:timeout, "the Python worker did not finish within #{timeout} ms",
      why: "the component was still handling this message, and the worker was killed",
      fix: "increase timeout:, or use on_error: :restart or :skip"
    )
  end
end
