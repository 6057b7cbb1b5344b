defmodule Situ.Conformance.PipelineLifecycle.Telling do
  # Sends messages from components to the case that runs them.

  def teller do
    me = self()
    tag = make_ref()
    {fn event -> send(me, {tag, event}) end, tag}
  end

  def drain(tag) do
    receive do
      {^tag, event} -> [event | drain(tag)]
    after
      0 -> []
    end
  end

  def values([%{"v" => _} | _] = messages), do: Enum.map(messages, & &1["v"])
  def values(values), do: values

  def until_running(pid) do
    if Situ.Pipeline.state(pid) in [:building, :starting], do: until_running(pid), else: :ok
  end
end

defmodule Situ.Conformance.PipelineLifecycle.Scopes do
  # The subpipelines of a case: lists of members by name ("subpipelines": {"Q": ["D", "R"]}), where
  # a member may be another subpipeline by name, or an object; or all pipelines by name, the
  # outermost first ("pipelines": {"P": ["A"]}, "nesting": ["P", "Q"]).
  alias Situ.Conformance.Text

  # Returns `{scope, names of components}` for the pipeline (scope nil) and every subpipeline.
  def groups(%{"pipelines" => %{} = pipelines} = params) do
    [_ | nested] = names = params["nesting"] || Text.unknown!("the nesting of pipelines", params)

    for {name, i} <- Enum.with_index(names) do
      scope = if i > 0, do: nested |> Enum.take(i) |> Enum.join(".")
      {scope, Map.fetch!(pipelines, name)}
    end
  end

  def groups(params) do
    subs = flat(params["subpipelines"] || %{})
    names = params["components"] || params["construction_order"]

    own =
      for {sub, members} <- subs,
          do: {path(sub, subs), Enum.reject(members, &is_map_key(subs, &1))}

    inner = Enum.flat_map(own, &elem(&1, 1))
    [{nil, Enum.reject(names, &(&1 in inner or is_map_key(subs, &1)))} | own]
  end

  # Returns the scope of a component, or nil if it is in the pipeline itself.
  def scope(name, params) do
    subs = flat(params["subpipelines"] || %{})
    sub = Enum.find_value(subs, fn {sub, members} -> name in members && sub end)
    sub && path(sub, subs)
  end

  # Returns the names of all subpipelines.
  def names(params), do: Map.keys(flat(params["subpipelines"] || %{}))

  # Objects among the members become subpipelines by name.
  defp flat(subs) do
    Enum.reduce(subs, %{}, fn {sub, members}, all ->
      {objects, names} = Enum.split_with(members, &is_map/1)
      inner = Enum.reduce(objects, %{}, &Map.merge(&2, &1))
      all |> Map.merge(flat(inner)) |> Map.put(sub, names ++ Map.keys(inner))
    end)
  end

  defp path(sub, subs) do
    case Enum.find(subs, fn {_, members} -> sub in members end) do
      {outer, _} -> path(outer, subs) <> "." <> sub
      nil -> sub
    end
  end
end
