defmodule Situ.Build.Architecture do
  @moduledoc """
  Which app may use which: the whole architecture in one table, and the reader that holds compiled code against it.
  """
  alias Situ.Build.Beam

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
    situ_space: [:situ, :situ_media, :situ_store, :situ_types],
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

  @doc """
  The apps that `app` may use.

      iex> Situ.Build.Architecture.allowed(:situ_infer)
      [:situ, :situ_media, :situ_types]
  """
  @spec allowed(atom()) :: [atom()]
  def allowed(app), do: Map.fetch!(@allowed, app)

  @doc "Every compiled module of the project's apps below `lib`, by app."
  @spec modules(Path.t()) :: %{atom() => [Beam.t()]}
  def modules(lib) do
    Map.new(@allowed, fn {app, _} ->
      {app, Beam.read_all(Path.join([lib, to_string(app), "ebin"]))}
    end)
  end

  @doc """
  One sentence for every reference between apps that the table does not allow.

      iex> beam = fn module, names -> %Situ.Build.Beam{module: module, names: names, source: "", calls: []} end
      iex> Situ.Build.Architecture.violations(%{situ: [beam.(A, [B])], situ_store: [beam.(B, [A])]})
      ["situ must not use situ_store: A names B"]
  """
  @spec violations(%{atom() => [Beam.t()]}) :: [String.t()]
  def violations(modules) do
    owner = for {app, beams} <- modules, beam <- beams, into: %{}, do: {beam.module, app}

    for {app, beams} <- modules,
        %{module: module, names: names} <- beams,
        used <- names,
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
end
