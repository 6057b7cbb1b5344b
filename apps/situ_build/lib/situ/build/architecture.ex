defmodule Situ.Build.Architecture do
  @moduledoc false
  # The architecture: a table of the apps that each app may use, and functions that check compiled
  # code against it.
  # The compiler warns about calls into an undeclared app, but not about `%Sibling{}` or a module
  # name used as a value, and `:xref` misses both. The abstract code of the compiled modules shows
  # all three, in less than a second and without recompiling. A compiler tracer would see only the
  # files being compiled. Module names that are built at run time escape this check.
  alias Situ.Build.Beam

  # Any app may name the build tool, because it is not part of the running system.
  @build :situ_build

  # From bottom to top: each app and the apps that it may use.
  @allowed %{
    situ_build: [],
    situ_types: [],
    situ: [:situ_types],
    situ_store: [:situ, :situ_types],
    situ_dataset: [:situ, :situ_store, :situ_types],
    situ_experiment: [:situ, :situ_dataset, :situ_store, :situ_types],
    situ_media: [:situ, :situ_store, :situ_types],
    situ_space: [:situ, :situ_media, :situ_store, :situ_types],
    situ_infer: [:situ, :situ_media, :situ_types],
    situ_assistant: [:situ, :situ_infer, :situ_media, :situ_store, :situ_types],
    situ_link: [:situ, :situ_store, :situ_types],
    situ_cluster: [:situ, :situ_link, :situ_store, :situ_types],
    situ_bridge: [:situ, :situ_store, :situ_types],
    situ_python: [:situ, :situ_store, :situ_types],
    situ_live: [:situ_types]
  }

  @below_studio Map.keys(@allowed) -- [:situ_assistant, :situ_build]
  @allowed Map.merge(@allowed, %{
             situ_studio: @below_studio,
             situ_cli: [:situ_assistant, :situ_studio | @below_studio],
             situ_examples: [:situ_assistant, :situ_cli, :situ_studio | @below_studio]
           })

  @doc """
  Returns the apps that `app` may use.

      iex> Situ.Build.Architecture.allowed_apps(:situ_infer)
      [:situ, :situ_media, :situ_types]
  """
  @spec allowed_apps(atom()) :: [atom()]
  def allowed_apps(app), do: Map.fetch!(@allowed, app)

  @doc "Reads all compiled modules of the project's apps in `lib`, grouped by app."
  @spec read_modules(Path.t()) :: %{atom() => [Beam.t()]}
  def read_modules(lib) do
    Map.new(@allowed, fn {app, _} ->
      {app, Beam.read_all(Path.join([lib, to_string(app), "ebin"]))}
    end)
  end

  @doc """
  Returns one sentence for each reference between apps that the table does not allow.

      iex> beam = fn module, names -> %Situ.Build.Beam{module: module, names: names, source: "", calls: []} end
      iex> Situ.Build.Architecture.find_violations(%{situ: [beam.(A, [B])], situ_store: [beam.(B, [A])]})
      ["situ must not use situ_store: A names B"]
  """
  @spec find_violations(%{atom() => [Beam.t()]}) :: [String.t()]
  def find_violations(modules) do
    owner = for {app, beams} <- modules, beam <- beams, into: %{}, do: {beam.module, app}

    for {app, beams} <- modules,
        %{module: module, names: names} <- beams,
        used <- names,
        to = owner[used],
        to not in [nil, app, @build],
        to not in allowed_apps(app) do
      "#{app} must not use #{to}: #{inspect(module)} names #{inspect(used)}"
    end
    |> Enum.sort()
  end

  @doc """
  Returns one sentence for each dependency in a `mix.exs` that the table does not allow.

      iex> Situ.Build.Architecture.undeclared_deps(%{situ: [:situ_media]})
      ["apps/situ/mix.exs declares situ_media, which the architecture does not allow"]
  """
  @spec undeclared_deps(%{atom() => [atom()]}) :: [String.t()]
  def undeclared_deps(declared) do
    for {app, deps} <- declared, dep <- deps, dep != @build, dep not in allowed_apps(app) do
      "apps/#{app}/mix.exs declares #{dep}, which the architecture does not allow"
    end
  end
end
