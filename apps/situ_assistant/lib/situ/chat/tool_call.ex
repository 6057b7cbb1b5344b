defmodule Situ.Chat.ToolCall do
  @moduledoc false
  # A tool call requested by a language model: the `id` of the call, the tool's `name`, and its
  # `arguments`, a map with string keys. If the model's arguments are not valid JSON, `arguments`
  # is `%{}`; `raw` always contains their text.
  @enforce_keys [:id, :name, :arguments, :raw]
  defstruct [:id, :name, :arguments, :raw]

  @type t :: %__MODULE__{id: String.t(), name: String.t(), arguments: map(), raw: String.t()}

  @doc """
  Builds a call from the arguments as the model wrote them.

      iex> Situ.Chat.ToolCall.new("1", "timer", ~s({"minutes": 5})).arguments
      %{"minutes" => 5}
      iex> Situ.Chat.ToolCall.new("1", "timer", "five").raw
      "five"
  """
  @spec new(String.t(), String.t(), String.t()) :: t()
  def new(id, name, raw) do
    arguments =
      case Situ.JSON.decode(raw) do
        {:ok, %{} = arguments} -> arguments
        _ -> %{}
      end

    %__MODULE__{id: id, name: name, arguments: arguments, raw: raw}
  end
end
