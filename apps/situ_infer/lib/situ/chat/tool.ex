defmodule Situ.Chat.Tool do
  @moduledoc """
  A tool that a language model may call: its name, what it is for, the JSON schema of its arguments, and the function
  that does it.

      %Situ.Chat.Tool{
        name: "set_timer",
        about: "Rings after some minutes.",
        arguments: %{type: "object", properties: %{minutes: %{type: "number"}}, required: ["minutes"]},
        run: fn %{"minutes" => minutes} -> "It will ring in \#{minutes} minutes." end
      }

  `run` takes the arguments as a map with string keys, **as the model wrote them: check them**, and answers a text (or
  what JSON can say). It runs in a process of its own that `cancel` may kill. Without it the call is a message on
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

  @doc "The tool as the protocol describes it."
  @spec to_json(t()) :: map()
  def to_json(%__MODULE__{} = tool) do
    function = %{name: tool.name, description: tool.about, parameters: tool.arguments}
    %{type: "function", function: function}
  end

  @doc "The tool's answer to a call; for a missing tool or one that fails, a text for the model with the reason."
  @spec answer([t()], Situ.Chat.ToolCall.t()) :: String.t()
  def answer(tools, call) do
    case Enum.find(tools, &(&1.name == call.name)) do
      %{run: run} when is_function(run, 1) -> text(attempt(run, call.arguments))
      _ -> "error: there is no tool #{call.name}"
    end
  end

  # At the edge to foreign code: the model may call it with anything.
  defp attempt(run, arguments) do
    run.(arguments)
  rescue
    error -> "error: the tool failed with #{inspect(error.__struct__)}"
  end

  defp text(text) when is_binary(text), do: text
  defp text(value), do: Situ.JSON.encode(value)
end
