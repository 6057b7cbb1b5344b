defmodule Situ.Live.JS do
  @moduledoc """
  Builds commands that the browser runs without the server, for `phx-click` and the like (same form as
  `Phoenix.LiveView.JS`).

      iex> Situ.Live.JS.toggle(to: "#menu") |> Situ.Live.JS.push("opened") |> to_string()
      ~s([["toggle",{"to":"#menu"}],["push",{"event":"opened"}]])
  """
  defstruct ops: []

  @type t :: %__MODULE__{ops: [[String.t() | map()]]}

  @doc "Sends an event to the view; options `value:` (a map), `target:`, `loading:`."
  @spec push(t(), String.t(), keyword()) :: t()
  def push(js \\ %__MODULE__{}, event, opts \\ [])

  def push(event, opts, []) when is_binary(event) and is_list(opts),
    do: push(%__MODULE__{}, event, opts)

  def push(%__MODULE__{} = js, event, opts), do: add_op(js, "push", [event: event] ++ opts)

  @doc "Shows the elements that match the selector `to:`."
  @spec show(t(), keyword()) :: t()
  def show(js \\ %__MODULE__{}, opts), do: add_op(js, "show", opts)

  @doc "Hides the elements that match the selector `to:`."
  @spec hide(t(), keyword()) :: t()
  def hide(js \\ %__MODULE__{}, opts), do: add_op(js, "hide", opts)

  @doc "Shows hidden elements and hides visible ones."
  @spec toggle(t(), keyword()) :: t()
  def toggle(js \\ %__MODULE__{}, opts), do: add_op(js, "toggle", opts)

  @doc "Dispatches a DOM event; option `detail:` (a map)."
  @spec dispatch(t(), String.t(), keyword()) :: t()
  def dispatch(js \\ %__MODULE__{}, event, opts),
    do: add_op(js, "dispatch", [event: event] ++ opts)

  @doc "Focuses an element."
  @spec focus(t(), keyword()) :: t()
  def focus(js \\ %__MODULE__{}, opts), do: add_op(js, "focus", opts)

  @doc "Navigates to a path within the same view."
  @spec patch(t(), String.t()) :: t()
  def patch(js \\ %__MODULE__{}, href), do: add_op(js, "patch", href: href)

  @doc "Navigates to another view."
  @spec navigate(t(), String.t()) :: t()
  def navigate(js \\ %__MODULE__{}, href), do: add_op(js, "navigate", href: href)

  defp add_op(%__MODULE__{ops: ops} = js, name, args),
    do: %{js | ops: ops ++ [[name, Map.new(args)]]}

  defimpl String.Chars do
    def to_string(js), do: Situ.JSON.encode(js.ops)
  end
end
