defmodule Situ.Build.Architecture do
  @moduledoc """
  Which app may use which: the whole architecture in one table, and the reader that holds compiled code against it.
  """

  # The build tool may be named by any app; it is not there at run time.
  @build :situ_build

  # From below: each app with those that it may use. Types stand below all others.
  @allowed %{
    situ_build: [],
    situ_types: [],
    situ: [:situ_types],
    situ_store: [:situ, :situ_types],
    situ_dataset: [:situ, :situ_store, :situ_types],
    situ_media: [:situ, :situ_store, :situ_types],
    situ_space: [:situ, :situ_media, :situ_types],
    situ_infer: [:situ, :situ_media, :situ_types],
    situ_remote: [:situ, :situ_store, :situ_types],
    situ_bridge: [:situ, :situ_store, :situ_types],
    situ_live: [:situ_types]
  }

  @below_studio Map.keys(@allowed) -- [:situ_build]
  @allowed Map.merge(@allowed, %{
             situ_studio: @below_studio,
             situ_cli: [:situ_studio | @below_studio],
             situ_examples: [:situ_cli, :situ_studio | @below_studio]
           })

  @type usage :: %{app: atom(), module: module(), uses: MapSet.t(module())}

  @doc """
  The apps that `app` may use.

      iex> Situ.Build.Architecture.allowed(:situ_infer)
      [:situ, :situ_media, :situ_types]
  """
  @spec allowed(atom()) :: [atom()]
  def allowed(app), do: Map.fetch!(@allowed, app)

  @doc "Every compiled module of the project's apps below `lib`, with all atoms its code mentions."
  @spec modules(Path.t()) :: [usage()]
  def modules(lib) do
    for app <- Map.keys(@allowed),
        beam <- Path.wildcard(Path.join([lib, to_string(app), "ebin", "*.beam"])) do
      {module, atoms} = atoms(beam)
      %{app: app, module: module, uses: atoms}
    end
  end

  @doc """
  One sentence for every reference between apps that the table does not allow.

      iex> modules = [
      ...>   %{app: :situ, module: A, uses: MapSet.new([B])},
      ...>   %{app: :situ_store, module: B, uses: MapSet.new([A])}
      ...> ]
      iex> Situ.Build.Architecture.violations(modules)
      ["situ must not use situ_store: A names B"]
  """
  @spec violations([usage()]) :: [String.t()]
  def violations(modules) do
    owner = Map.new(modules, &{&1.module, &1.app})

    for %{app: app, module: module, uses: uses} <- modules,
        used <- uses,
        to = owner[used],
        to not in [nil, app, @build],
        to not in allowed(app) do
      "#{app} must not use #{to}: #{inspect(module)} names #{inspect(used)}"
    end
    |> Enum.sort()
  end

  @doc """
  One sentence for every dependency declared in a `mix.exs` beyond the table.

      iex> Situ.Build.Architecture.undeclared(%{situ: [:situ_media]})
      ["apps/situ/mix.exs declares situ_media, which the architecture does not allow"]
  """
  @spec undeclared(%{atom() => [atom()]}) :: [String.t()]
  def undeclared(declared) do
    for {app, deps} <- declared, dep <- deps, dep != @build, dep not in allowed(app) do
      "apps/#{app}/mix.exs declares #{dep}, which the architecture does not allow"
    end
  end

  defp atoms(beam) do
    {:ok, {module, [debug_info: {:debug_info_v1, backend, data}]}} =
      :beam_lib.chunks(String.to_charlist(beam), [:debug_info])

    {:ok, forms} = backend.debug_info(:erlang_v1, module, data, [])
    {module, collect(forms, MapSet.new())}
  end

  defp collect(atom, found) when is_atom(atom), do: MapSet.put(found, atom)
  defp collect([head | tail], found), do: collect(tail, collect(head, found))
  defp collect(tuple, found) when is_tuple(tuple), do: collect(Tuple.to_list(tuple), found)
  defp collect(map, found) when is_map(map), do: collect(Map.to_list(map), found)
  defp collect(_other, found), do: found
end
