defmodule Situ.Chat.Turn do
  @moduledoc """
  One turn in a conversation with a language model: its `role` (`:system`, `:user`, `:assistant`, `:tool`) and `text`, a
  user's images, the assistant's tool calls, or the id of the call whose result a tool turn contains.

      iex> Situ.Chat.Turn.to_json(Situ.Chat.Turn.user("Who are you?"))
      %{role: "user", content: "Who are you?"}
  """
  alias Situ.Chat.ToolCall
  alias Situ.EncodedImage

  @enforce_keys [:role, :text]
  defstruct [:role, :text, images: [], calls: [], call: nil]

  @type t :: %__MODULE__{
          role: :system | :user | :assistant | :tool,
          text: String.t(),
          images: [EncodedImage.t()],
          calls: [ToolCall.t()],
          call: String.t() | nil
        }

  @doc "Builds a turn with instructions for the model."
  @spec system(String.t()) :: t()
  def system(text), do: %__MODULE__{role: :system, text: text}

  @doc "Builds a turn of a user, optionally with images (`Situ.EncodedImage`, JPEG or PNG)."
  @spec user(String.t(), [EncodedImage.t()]) :: t()
  def user(text, images \\ []), do: %__MODULE__{role: :user, text: text, images: images}

  @doc "Builds a turn of the model, optionally with tool calls."
  @spec assistant(String.t(), [ToolCall.t()]) :: t()
  def assistant(text, calls \\ []), do: %__MODULE__{role: :assistant, text: text, calls: calls}

  @doc "Builds a turn with the result of the tool call with this id."
  @spec tool(String.t(), String.t()) :: t()
  def tool(call, text), do: %__MODULE__{role: :tool, text: text, call: call}

  @doc "Converts the turn to the protocol's JSON."
  @spec to_json(t()) :: map()
  def to_json(%__MODULE__{role: :tool} = turn),
    do: %{role: "tool", tool_call_id: turn.call, content: turn.text}

  def to_json(%__MODULE__{role: :assistant, calls: [_ | _]} = turn) do
    calls =
      for call <- turn.calls do
        function = %{name: call.name, arguments: Situ.JSON.encode(call.arguments)}
        %{id: call.id, type: "function", function: function}
      end

    %{role: "assistant", content: turn.text, tool_calls: calls}
  end

  def to_json(%__MODULE__{role: :user, images: [_ | _]} = turn) do
    pictures =
      for image <- turn.images, do: %{type: "image_url", image_url: %{url: data_url(image)}}

    %{role: "user", content: [%{type: "text", text: turn.text} | pictures]}
  end

  def to_json(%__MODULE__{role: role, text: text}),
    do: %{role: Atom.to_string(role), content: text}

  defp data_url(%EncodedImage{format: format, data: data}),
    do: "data:image/#{format};base64," <> Base.encode64(data)
end
