defmodule Situ.Studio.Plugins do
  @moduledoc """
  Loads third-party extensions: visualizers, adapters, file formats and tasks.

  A **plug-in** is a folder:

      gaze-heat-map/
        plugin.json       its metadata and visualizers (`Situ.Studio.Plugins.Manifest`)
        lib/*.ex          Elixir modules, recognized by their behaviours
        web/*.js          ES modules that draw in the page
        test/             tests of both; run them with `situ plugin test FOLDER`

  Plug-ins are loaded from the folders that the user names (`plugins:` of `Situ.Studio`,
  `--plugins` on the command line) and from `$XDG_CONFIG_HOME/situ/plugins`. **They run with all
  permissions of the user**, like any other program, so use only folders whose authors you
  trust. The page's content security policy allows scripts only from these folders; a plug-in
  cannot load anything from another site.

  Modules in `lib/` are recognized by their behaviours:

  | behaviour | becomes |
  |---|---|
  | `Situ.Studio.Visualizer` | a visualizer (a module named in the manifest belongs to that entry) |
  | `Situ.Studio.Adapter` | an adapter |
  | `Situ.Recording.Format` | a file format: its files open as recordings, also on the command line |
  | `Situ.Dataset.Task` | a task of `situ task` and of the studio |

  An application can provide the same modules without a folder through its configuration:
  `studio_visualizers`, `studio_adapters`, `recording_formats` and `dataset_tasks` in `env:` of
  its `mix.exs`.

  A broken plug-in affects nothing else. If its code does not compile, its visualizers stay
  available and their panels show the error. Code of plug-ins runs in separate processes. The guide "Your own
  visualizer" builds a plug-in.
  """
  # See docs/adr/0083-plug-ins-are-folders-with-a-manifest.md.
  alias Situ.Error
  alias Situ.Studio.{Adapter, Visualizer, Visualizers}
  alias Situ.Studio.Plugins.{Code, Manifest}

  defmodule Plugin do
    @moduledoc false
    # Represents a loaded plug-in; `problem` explains why it cannot be used.
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

  @doc "Returns the default plug-in folder, `$XDG_CONFIG_HOME/situ/plugins`, which is always searched."
  @spec default_dir() :: Path.t()
  def default_dir do
    config = System.get_env("XDG_CONFIG_HOME") || Path.join(System.user_home() || ".", ".config")
    Path.join([config, "situ", "plugins"])
  end

  @doc """
  Loads the plug-ins from folders that are plug-ins or contain plug-ins; other folders are skipped. A plug-in that is
  broken, or whose id is already used by another plug-in, is listed with its problem.

      iex> Situ.Studio.Plugins.load(["/there/is/no/such/folder"])
      []
  """
  @spec load([Path.t()]) :: [Plugin.t()]
  def load(folders) do
    folders
    |> Enum.flat_map(&plugin_folders/1)
    |> Enum.uniq()
    |> Enum.map(&plugin/1)
    |> Enum.reduce([], &if(duplicate?(&2, &1), do: [mark_duplicate(&1) | &2], else: [&1 | &2]))
    |> Enum.reverse()
  end

  defp plugin_folders(folder) do
    folder = Path.expand(folder)

    if File.regular?(manifest_path(folder)),
      do: [folder],
      else: folder |> Path.join("*/plugin.json") |> Path.wildcard() |> Enum.map(&Path.dirname/1)
  end

  defp manifest_path(folder), do: Path.join(folder, "plugin.json")

  defp duplicate?(plugins, %{id: id}), do: Enum.any?(plugins, &(&1.id == id))

  defp mark_duplicate(plugin) do
    problem = "another plug-in has the same id, #{plugin.id}"
    %{plugin | problem: problem, visualizers: [], modules: []}
  end

  @doc """
  Loads one plug-in from its folder. In the result, `problem` explains why the plug-in cannot be used (`nil` if it can),
  `visualizers` lists its `t:Situ.Studio.Visualizer.t/0`s, and `modules` the modules of its `lib` folder.
  """
  @spec plugin(Path.t()) :: Plugin.t()
  def plugin(folder) do
    folder = Path.expand(folder)

    case Manifest.load(manifest_path(folder)) do
      {:ok, manifest} ->
        load_code(manifest, folder)

      {:error, error} ->
        name = Path.basename(folder)
        %Plugin{id: name, title: name, folder: folder, problem: error.what}
    end
  end

  defp load_code(manifest, folder) do
    plugin = %Plugin{id: manifest.id, title: manifest.title, folder: folder}

    with {:ok, modules} <- Code.load_modules(folder),
         {:ok, parts} <- resolve_parts(manifest.parts, modules, folder) do
      %{
        plugin
        | modules: modules,
          visualizers: parts ++ standalone_visualizers(modules, parts, plugin)
      }
    else
      {:error, %Error{what: what}} ->
        broken = for part <- manifest.parts, do: broken_visualizer(part.visualizer, what)
        %{plugin | problem: what, visualizers: broken}
    end
  end

  # A broken visualizer stays in its panel and shows the problem.
  defp broken_visualizer(visualizer, what) do
    panel = if visualizer.panel in [:plot, :lanes], do: visualizer.panel, else: :own

    %{
      visualizer
      | panel: panel,
        drawer: "broken",
        module: Visualizers.BrokenPlugin,
        problem: what
    }
  end

  defp resolve_parts(parts, modules, folder) do
    Error.map_ok(parts, fn %{visualizer: v} = part ->
      with {:ok, module} <- resolve_module(part.module, modules),
           {:ok, script} <- resolve_script(part, folder),
           do: {:ok, %{v | module: module || v.module, script: script}}
    end)
  end

  defp resolve_module(nil, _modules), do: {:ok, nil}

  defp resolve_module(name, modules) do
    case Enum.find(modules, &(inspect(&1) == name)) do
      nil -> {:error, Error.new(:bad_plugin, "its manifest names #{name}, which is not in lib/")}
      module -> {:ok, module}
    end
  end

  defp resolve_script(%{script: nil}, _folder), do: {:ok, nil}

  defp resolve_script(%{script: "web/" <> rest = path, visualizer: v}, folder) do
    if File.regular?(Path.join(folder, path)),
      do: {:ok, "/plugins/#{v.plugin}/#{rest}"},
      else: {:error, Error.new(:bad_plugin, "the script #{path} does not exist")}
  end

  # Returns the visualizer modules that the manifest does not name.
  defp standalone_visualizers(modules, parts, plugin) do
    for module <- Code.filter_by_behaviour(modules, Visualizer),
        not Enum.any?(parts, &(&1.module == module)) do
      %{Visualizer.to_visualizer(module) | plugin: plugin.id}
    end
  end

  @doc "Returns the visualizers of plug-ins and applications, and the visualizers that adapters add."
  @spec list_visualizers([Plugin.t()], [Visualizer.given()], [module()]) :: [Visualizer.t()]
  def list_visualizers(plugins, given \\ [], adapters \\ []) do
    own =
      Enum.map(given ++ configured_modules(:studio_visualizers), &Visualizer.to_visualizer/1) ++
        Enum.flat_map(plugins, & &1.visualizers)

    all = own ++ Visualizers.all()

    own ++
      Enum.flat_map(
        adapters ++ configured_modules(:studio_adapters),
        &Adapter.adapted_visualizers(&1, all)
      ) ++
      for plugin <- plugins,
          adapter <- Code.filter_by_behaviour(plugin.modules, Adapter),
          v <- Adapter.adapted_visualizers(adapter, all),
          do: %{v | plugin: v.plugin || plugin.id}
  end

  # Returns the modules that loaded applications list in their configuration.
  defp configured_modules(key) do
    for {app, _, _} <- Application.loaded_applications(),
        module <- Application.get_env(app, key, []),
        do: module
  end

  @doc "Registers the file formats and tasks of plug-ins with stores and datasets in this VM."
  @spec register_modules([Plugin.t()]) :: :ok
  def register_modules(plugins) do
    modules = Enum.flat_map(plugins, & &1.modules)
    append_env(:situ_store, :formats, Code.filter_by_behaviour(modules, Situ.Recording.Format))

    append_env(
      :situ_dataset,
      :dataset_tasks,
      Code.filter_by_behaviour(modules, Situ.Dataset.Task)
    )
  end

  defp append_env(_app, _key, []), do: :ok

  defp append_env(app, key, modules) do
    Application.load(app)
    Application.put_env(app, key, Enum.uniq(Application.get_env(app, key, []) ++ modules))
  end

  @doc "Returns the routes that serve the plug-ins' scripts."
  @spec script_routes([Plugin.t()]) :: [tuple()]
  def script_routes(plugins) do
    for %{problem: nil} = plugin <- plugins,
        do: {:static, "/plugins/#{plugin.id}", Path.join(plugin.folder, "web"), cache: "no-cache"}
  end
end
