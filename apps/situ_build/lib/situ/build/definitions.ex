defmodule Situ.Build.Definitions do
  @moduledoc false
  # Reads the modules and functions that a source file defines, from its syntax tree.
  #
  # Callbacks (functions after `@impl`, and the functions of protocols and their implementations)
  # are left out, because another module chose their names.

  @public [:def, :defdelegate, :defmacro]
  @private [:defp, :defmacrop]

  @type t :: %{modules: [String.t()], functions: [{:public | :private, String.t()}]}

  @doc """
  Returns the modules and the functions that `source` defines, each once.

      iex> Situ.Build.Definitions.read("defmodule A.B do\\n  def push(queue, item), do: queue ++ [item]\\nend")
      %{modules: ["A.B"], functions: [{:public, "push"}]}
  """
  @spec read(String.t()) :: t()
  def read(source) do
    found = source |> Code.string_to_quoted!() |> collect_definitions(nil)

    %{
      modules: for({:module, name} <- found, do: name),
      functions: for({kind, name, _module} <- Enum.uniq(found), do: {kind, name})
    }
  end

  defp collect_definitions({:defmodule, _, [{:__aliases__, _, parts}, [{_do, body}]]}, outer) do
    name = [outer | parts] |> Enum.reject(&is_nil/1) |> Enum.map_join(".", &to_string/1)
    [{:module, name} | collect_body(body, name)]
  end

  defp collect_definitions({kind, _, _}, _outer) when kind in [:defimpl, :defprotocol, :quote],
    do: []

  defp collect_definitions({_, _, arguments}, outer) when is_list(arguments),
    do: collect_definitions(arguments, outer)

  defp collect_definitions({left, right}, outer),
    do: collect_definitions(left, outer) ++ collect_definitions(right, outer)

  defp collect_definitions(list, outer) when is_list(list),
    do: Enum.flat_map(list, &collect_definitions(&1, outer))

  defp collect_definitions(_other, _outer), do: []

  defp collect_body({:__block__, _, expressions}, module) do
    {found, _} = Enum.flat_map_reduce(expressions, false, &collect_expression(&1, &2, module))
    callbacks = for {:callback, name} <- found, into: MapSet.new(), do: name
    Enum.reject(found, &callback?(&1, callbacks))
  end

  defp collect_body(expression, module), do: collect_body({:__block__, [], [expression]}, module)

  defp callback?({:callback, _name}, _callbacks), do: true
  defp callback?({:public, name, _module}, callbacks), do: name in callbacks
  defp callback?(_found, _callbacks), do: false

  # The second argument says whether `@impl` precedes the expression.
  defp collect_expression({:@, _, [{:impl, _, [value]}]}, _impl?, _module),
    do: {[], value != false}

  defp collect_expression({kind, _, [head | _]}, impl?, module) when kind in @public,
    do: {collect_head(if(impl?, do: :callback, else: :public), head, module), false}

  defp collect_expression({kind, _, [head | _]}, _impl?, module) when kind in @private,
    do: {collect_head(:private, head, module), false}

  defp collect_expression({:@, _, _}, impl?, _module), do: {[], impl?}
  defp collect_expression(other, _impl?, module), do: {collect_definitions(other, module), false}

  defp collect_head(kind, {:when, _, [head | _]}, module), do: collect_head(kind, head, module)

  defp collect_head(_kind, {name, _, _}, _module) when name in [:unquote, :child_spec], do: []
  defp collect_head(:callback, {name, _, _}, _) when is_atom(name), do: [{:callback, "#{name}"}]

  defp collect_head(kind, {name, _, _}, module) when is_atom(name),
    do: [{kind, "#{name}", module}]

  defp collect_head(_kind, _head, _module), do: []
end
