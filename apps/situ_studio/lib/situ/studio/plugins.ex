defmodule Situ.Studio.Plugins do
  @moduledoc """
  Extensions of Situ by others, without changing it: visualizers, adapters, readers of files, tasks.

  A **plug-in** is a folder:

      gaze-heat-map/
        plugin.json       what it is, and which visualizers it has (`Situ.Studio.Plugins.Manifest`)
        lib/*.ex          Elixir modules, found by their behaviours
        web/*.js          ES modules that draw in the page
        test/             tests of both, `situ plugin test FOLDER`

  Plug-ins are looked for in folders that the user names (`plugins:` of `Situ.Studio`, `--plugins` on the command line)
  and in `$XDG_CONFIG_HOME/situ/plugins`. **They run with all the rights of the user**, as any program does: trust a
  folder only as far as its authors. The page loads scripts from there only, under its content security policy;
  nothing of a plug-in can come from another site.

  Found by their behaviours in `lib/`:

  | behaviour | becomes |
  |---|---|
  | `Situ.Studio.Visualizer` | a visualizer (one that a part of the manifest names is that part's module) |
  | `Situ.Studio.Adapter` | an adapter |
  | `Situ.Store.Reader` | a reader: files of its extensions open as recordings, on the command line too |
  | `Situ.Dataset.Task` | a task of `situ task` and of the studio |

  Without a folder, an application brings the same by its configuration: `studio_visualizers`, `studio_adapters`,
  `store_readers` and `dataset_tasks` in `env:` of its `mix.exs`.

  A broken plug-in harms nothing else. If its code does not compile, its visualizers remain and their panels show the
  error. Code of plug-ins runs in processes of its own (`Situ.Studio.Plugins.Guard`).
  """
  alias Situ.Error
  alias Situ.Studio.{Adapter, Visualizer, Visualizers}
  alias Situ.Studio.Plugins.{Code, Manifest}

  defmodule Plugin do
    @moduledoc "One plug-in; `problem` is why it cannot be used, in words."
    @enforce_keys [:id, :title, :folder]
    defstruct [:id, :title, :folder, :problem, visualizers: [], modules: []]

    @type t :: %__MODULE__{
            id: String.t(),
            title: String.t(),
            folder: Path.t(),
            problem: String.t() | nil,
            visualizers: [Situ.Studio.Visualizer.t()],
            modules: [module()]
          }
  end

  @doc "The folder of plug-ins that is always looked into: `$XDG_CONFIG_HOME/situ/plugins`."
  @spec default_dir() :: Path.t()
  def default_dir do
    config = System.get_env("XDG_CONFIG_HOME") || Path.join(System.user_home() || ".", ".config")
    Path.join([config, "situ", "plugins"])
  end

  @doc """
  The plug-ins of some folders: each is one, or holds some. Other folders are skipped; a broken plug-in is listed with
  its problem; of two with one id, the second is listed with a problem.

      iex> Situ.Studio.Plugins.load(["/there/is/no/such/folder"])
      []
  """
  @spec load([Path.t()]) :: [Plugin.t()]
  def load(folders) do
    folders
    |> Enum.flat_map(&within/1)
    |> Enum.uniq()
    |> Enum.map(&plugin/1)
    |> Enum.reduce([], &if(taken?(&2, &1), do: [twice(&1) | &2], else: [&1 | &2]))
    |> Enum.reverse()
  end

  defp within(folder) do
    folder = Path.expand(folder)

    if File.regular?(manifest(folder)),
      do: [folder],
      else: folder |> Path.join("*/plugin.json") |> Path.wildcard() |> Enum.map(&Path.dirname/1)
  end

  defp manifest(folder), do: Path.join(folder, "plugin.json")

  defp taken?(plugins, %{id: id}), do: Enum.any?(plugins, &(&1.id == id))

  defp twice(plugin) do
    problem = "another plug-in is called #{plugin.id}, too"
    %{plugin | problem: problem, visualizers: [], modules: []}
  end

  @doc "One plug-in, from its folder."
  @spec plugin(Path.t()) :: Plugin.t()
  def plugin(folder) do
    folder = Path.expand(folder)

    case Manifest.load(manifest(folder)) do
      {:ok, manifest} ->
        with_code(manifest, folder)

      {:error, error} ->
        name = Path.basename(folder)
        %Plugin{id: name, title: name, folder: folder, problem: error.what}
    end
  end

  defp with_code(manifest, folder) do
    plugin = %Plugin{id: manifest.id, title: manifest.title, folder: folder}

    with {:ok, modules} <- Code.load(folder),
         {:ok, parts} <- parts(manifest.parts, modules, folder) do
      %{plugin | modules: modules, visualizers: parts ++ own(modules, parts, plugin)}
    else
      {:error, %Error{what: what}} ->
        broken = for part <- manifest.parts, do: broken(part.visualizer, what)
        %{plugin | problem: what, visualizers: broken}
    end
  end

  # It stays where it was, and says what is wrong.
  defp broken(visualizer, what) do
    panel = if visualizer.panel in [:plot, :lanes], do: visualizer.panel, else: :own
    %{visualizer | panel: panel, drawer: "broken", module: Visualizers.Broken, problem: what}
  end

  defp parts(parts, modules, folder) do
    Error.map(parts, fn %{visualizer: v} = part ->
      with {:ok, module} <- module(part.module, modules),
           {:ok, script} <- script(part, folder),
           do: {:ok, %{v | module: module || v.module, script: script}}
    end)
  end

  defp module(nil, _modules), do: {:ok, nil}

  defp module(name, modules) do
    case Enum.find(modules, &(inspect(&1) == name)) do
      nil -> {:error, Error.new(:bad_plugin, "it names #{name}, which is not in its lib/")}
      module -> {:ok, module}
    end
  end

  defp script(%{script: nil}, _folder), do: {:ok, nil}

  defp script(%{script: "web/" <> rest = path, visualizer: v}, folder) do
    if File.regular?(Path.join(folder, path)),
      do: {:ok, "/plugins/#{v.plugin}/#{rest}"},
      else: {:error, Error.new(:bad_plugin, "there is no #{path}")}
  end

  # Modules that are visualizers by themselves.
  defp own(modules, parts, plugin) do
    for module <- Code.of(modules, Visualizer),
        not Enum.any?(parts, &(&1.module == module)) do
      %{Visualizer.of(module) | plugin: plugin.id}
    end
  end

  @doc "Every visualizer of some plug-ins, and those that their adapters and `adapters` open."
  @spec visualizers([Plugin.t()], [Visualizer.given()], [module()]) :: [Visualizer.t()]
  def visualizers(plugins, given \\ [], adapters \\ []) do
    own =
      Enum.map(given ++ brought(:studio_visualizers), &Visualizer.of/1) ++
        Enum.flat_map(plugins, & &1.visualizers)

    all = own ++ Visualizers.all()

    own ++
      Enum.flat_map(adapters ++ brought(:studio_adapters), &Adapter.visualizers(&1, all)) ++
      for plugin <- plugins,
          adapter <- Code.of(plugin.modules, Adapter),
          v <- Adapter.visualizers(adapter, all),
          do: %{v | plugin: v.plugin || plugin.id}
  end

  # Modules that applications name in their configuration.
  defp brought(key) do
    for {app, _, _} <- Application.loaded_applications(),
        module <- Application.get_env(app, key, []),
        do: module
  end

  @doc "Makes the readers and tasks of plug-ins known to stores and datasets, in this VM."
  @spec register([Plugin.t()]) :: :ok
  def register(plugins) do
    modules = Enum.flat_map(plugins, & &1.modules)
    add(:situ_store, :readers, Code.of(modules, Situ.Store.Reader))
    add(:situ_dataset, :dataset_tasks, Code.of(modules, Situ.Dataset.Task))
  end

  defp add(_app, _key, []), do: :ok

  defp add(app, key, modules) do
    Application.load(app)
    Application.put_env(app, key, Enum.uniq(Application.get_env(app, key, []) ++ modules))
  end

  @doc "The addresses under which the pages find the scripts."
  @spec routes([Plugin.t()]) :: [tuple()]
  def routes(plugins) do
    for %{problem: nil} = plugin <- plugins,
        do: {:static, "/plugins/#{plugin.id}", Path.join(plugin.folder, "web"), cache: "no-cache"}
  end
end
