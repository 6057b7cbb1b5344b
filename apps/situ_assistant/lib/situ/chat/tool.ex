defmodule Situ.Chat.Tool do
  @moduledoc """
  A tool that a language model may call: its name, its purpose, the JSON schema of its arguments, and the function that
  implements it.

      %Situ.Chat.Tool{
        name: "set_timer",
        about: "Rings after some minutes.",
        arguments: %{type: "object", properties: %{minutes: %{type: "number"}}, required: ["minutes"]},
        run: fn %{"minutes" => minutes} -> "It will ring in \#{minutes} minutes." end
      }

  `run` takes the arguments as a map with string keys, **as the model wrote them, so validate them**, and returns a text
  (or a JSON value). It runs in a separate process that `cancel` may kill. If `run` is nil, the call is emitted on
  `:calls`, and the answer ends there.
  """
  @enforce_keys [:name, :about]
  defstruct [:name, :about, :run, arguments: %{type: "object", properties: %{}}]

  @type t :: %__MODULE__{
          name: String.t(),
          about: String.t(),
          arguments: map(),
          run: (map() -> String.t() | Situ.JSON.value()) | nil
        }

  @doc "Converts the tool to the protocol's description of a function."
  @spec to_json(t()) :: map()
  def to_json(%__MODULE__{} = tool) do
    function = %{name: tool.name, description: tool.about, parameters: tool.arguments}
    %{type: "function", function: function}
  end

  @doc "Runs the called tool and returns its result, or a text with the reason if the tool is unknown or fails."
  @spec run_call([t()], Situ.Chat.ToolCall.t()) :: String.t()
  def run_call(tools, call) do
    case Enum.find(tools, &(&1.name == call.name)) do
      %{run: run} when is_function(run, 1) -> result_text(run_safely(run, call.arguments))
      _ -> "error: unknown tool #{call.name}"
    end
  end

  # The function is user code and gets unchecked arguments from the model, so any error is caught.
  defp run_safely(run, arguments) do
    run.(arguments)
  rescue
    error -> "error: the tool failed with #{inspect(error.__struct__)}"
  end

  defp result_text(text) when is_binary(text), do: text
  defp result_text(value), do: Situ.JSON.encode(value)
end
