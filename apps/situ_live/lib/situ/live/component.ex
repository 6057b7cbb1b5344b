defmodule Situ.Live.Component do
  @moduledoc """
  Defines function components: functions of `assigns` that return `~H`.

      defmodule Buttons do
        use Situ.Live.Component

        attr :kind, :string, default: "plain"
        attr :rest, :global
        slot :inner_block, required: true

        def button(assigns) do
          ~H\"\"\"
          <button class={["button", @kind]} {@rest}>{render_slot(@inner_block)}</button>
          \"\"\"
        end
      end

      <Buttons.button kind="warm" phx-click="go">Go</Buttons.button>

  `attr` fills in defaults and raises if a required attribute is missing. `:global` collects the attributes that are
  not declared. Types only document the component.

  ## Templates

  `~H` compiles HTML with embedded Elixir; it supports the part of Phoenix's HEEx that views need.

    * `{expression}` in text and `name={expression}` in tags are always escaped
    * `class={["a", @on && "b"]}`; `nil` and `false` omit an attribute, `true` writes only its name; `{map}` spreads
    * `:if={...}`, `:for={x <- @xs}`, `:key={x.id}` work on any tag, component or slot
    * `<.card title="x">`, `<Other.card>` call function components; `<:name :let={x}>` are their slots
    * `phx-no-curly-interpolation` on a tag makes braces inside it plain text, as they are in `<script>` and `<style>`
    * `<%= expression %>` equals `{expression}`; `<%!-- --%>` is omitted; blocks (`<% if ... do %>`) are rejected

  A tag that is not closed, or is closed by another name, is a compile error with file, line and column. Only
  expressions whose assigns changed are evaluated again, so read assigns as `@name`.
  """
  alias Situ.Live.{Island, Rendered}

  @doc false
  defmacro __using__(_opts) do
    quote do
      import Situ.Live.Template, only: [sigil_H: 2]
      import Situ.Live.Socket, only: [assign: 2, assign: 3, assign_new: 3, update: 3]

      import Situ.Live.Component,
        only: [
          attr: 2,
          attr: 3,
          slot: 1,
          slot: 2,
          slot: 3,
          render_slot: 1,
          render_slot: 2,
          island: 1,
          link: 1
        ]

      Module.register_attribute(__MODULE__, :situ_live_attrs, accumulate: true)
      Module.register_attribute(__MODULE__, :situ_live_components, accumulate: true)
      @on_definition Situ.Live.Component
      @before_compile Situ.Live.Component
    end
  end

  @doc "Declares an attribute of the next component; options `default:`, `required:`, `doc:`."
  defmacro attr(name, type, opts \\ []) do
    quote do: @situ_live_attrs({:attr, unquote(name), unquote(type), unquote(opts)})
  end

  @doc "Declares a slot of the next component; options `required:`, `doc:`."
  defmacro slot(name, opts \\ []) do
    opts = if is_list(opts), do: Keyword.delete(opts, :do), else: opts
    quote do: @situ_live_attrs({:slot, unquote(name), :slot, unquote(opts)})
  end

  @doc "Declares a slot like `slot/2`; the attributes in the block only document it."
  defmacro slot(name, opts, do: _block), do: quote(do: slot(unquote(name), unquote(opts)))

  @doc false
  def __on_definition__(env, :def, name, [_assigns], _guards, _body) do
    case Module.delete_attribute(env.module, :situ_live_attrs) do
      [] ->
        :ok

      nil ->
        :ok

      declarations ->
        Module.put_attribute(env.module, :situ_live_components, {name, declarations})
    end

    Module.register_attribute(env.module, :situ_live_attrs, accumulate: true)
  end

  def __on_definition__(_env, _kind, _name, _args, _guards, _body), do: :ok

  @doc false
  defmacro __before_compile__(env) do
    for {name, declarations} <- Module.get_attribute(env.module, :situ_live_components) do
      quote do
        defoverridable [{unquote(name), 1}]

        def unquote(name)(assigns) do
          assigns
          |> Situ.Live.Component.apply_declarations(
            unquote(name),
            unquote(Macro.escape(declarations))
          )
          |> super()
        end
      end
    end
  end

  @doc false
  def apply_declarations(assigns, component, declarations) do
    names = Enum.map(declarations, &elem(&1, 1))

    Enum.reduce(declarations, assigns, fn
      {:attr, name, :global, opts}, acc ->
        rest = Map.drop(assigns, [:__changed__, :__slot__, :inner_block | names])
        Map.put_new(acc, name, Map.merge(opts[:default] || %{}, rest))

      {kind, name, _type, opts}, acc ->
        put_missing_assign(acc, component, kind, name, opts)
    end)
  end

  defp put_missing_assign(assigns, component, kind, name, opts) do
    missing? = not is_map_key(assigns, name) or (kind == :slot and assigns[name] == [])

    cond do
      missing? and opts[:required] ->
        raise ArgumentError, "component #{component} needs the #{kind} #{name}"

      kind == :slot ->
        Map.put_new(assigns, name, [])

      Keyword.has_key?(opts, :default) ->
        Map.put_new(assigns, name, opts[:default])

      true ->
        Map.put_new(assigns, name, nil)
    end
  end

  @doc "Renders a slot, with `argument` bound to the pattern of its `:let`."
  @spec render_slot([map()], term()) :: term()
  def render_slot(slots, argument \\ nil)
  def render_slot([], _), do: nil
  def render_slot(nil, _), do: nil
  def render_slot([slot], argument), do: slot.inner_block.(argument)
  def render_slot(%{inner_block: fun}, argument), do: fun.(argument)
  def render_slot(slots, argument), do: Enum.map(slots, & &1.inner_block.(argument))

  @doc """
  Renders a part of the page that the browser patches separately. A change inside costs the browser time in proportion
  to the island's size, and a change outside does not touch it. Use islands for large or frequently changing parts (a
  table, a row that ticks).

      <.island><table id="rows">...</table></.island>

  The content must be exactly one tag.
  """
  @spec island(map()) :: Rendered.t()
  def island(assigns) do
    case render_slot(assigns.inner_block) do
      %Rendered{root?: true} = rendered ->
        %Rendered{
          static: ["", ""],
          dynamic: [%Island{rendered: rendered}],
          fingerprint: rendered.fingerprint + 1
        }

      _ ->
        raise ArgumentError, "an island must contain exactly one tag, without :if or :for on it"
    end
  end

  @doc """
  Renders a link: `patch=` stays in the view, `navigate=` changes the view on the same connection, and `href=` loads a
  page.
  """
  @spec link(map()) :: Rendered.t()
  def link(assigns) do
    {to, link_attributes} =
      case assigns do
        %{patch: to} when is_binary(to) -> {to, %{"data-phx-link": "patch"}}
        %{navigate: to} when is_binary(to) -> {to, %{"data-phx-link": "redirect"}}
        _ -> {assigns[:href] || "#", %{}}
      end

    state = if assigns[:replace], do: "replace", else: "push"

    link_attributes =
      if link_attributes == %{},
        do: link_attributes,
        else: Map.put(link_attributes, :"data-phx-link-state", state)

    reserved = [:__changed__, :inner_block, :patch, :navigate, :href, :replace, :rest]
    rest = assigns |> Map.drop(reserved) |> Map.merge(Map.get(assigns, :rest) || %{})
    attributes = [{"href", safe_href(to)} | Enum.to_list(link_attributes) ++ Enum.to_list(rest)]

    %Rendered{
      static: ["<a", ">", "</a>"],
      dynamic: [
        Situ.Live.Html.escape(Situ.Live.Html.attributes(attributes)),
        Situ.Live.Html.escape(render_slot(assigns[:inner_block] || []))
      ],
      fingerprint: :erlang.phash2({__MODULE__, :link}, 4_294_967_296),
      root?: true
    }
  end

  # Prevents a stored name from becoming a script.
  defp safe_href(to) do
    if to
       |> String.trim()
       |> String.downcase()
       |> String.starts_with?(["javascript:", "data:", "vbscript:"]),
       do: raise(ArgumentError, "invalid link target: #{inspect(to)}"),
       else: to
  end
end
