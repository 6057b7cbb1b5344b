defmodule Situ.Integration do
  # The parts of a `mix.exs` that all integrations share. The `mix.exs` of each one loads this file.
  #
  # Packages come from Hex. If the environment variable SITU_HEX_PATH names a folder, they come from the folders in it
  # instead, one with the sources of each package and named like it in Hex. Mix then needs neither Hex nor the network.
  #
  # Situ is the compiled one, as in projects of `situ new` (docs/adr/0002-projects-use-the-compiled-situ.md), unless the
  # project that depends on the integration lists `:situ` among its own dependencies.
  # See docs/adr/0183-integrations-are-projects-outside-the-umbrella.md.

  defmodule Folder do
    # Finds packages in the folder SITU_HEX_PATH. Mix asks every SCM in turn whether a dependency is its own.
    @behaviour Mix.SCM

    @impl true
    def accepts_options(app, opts) do
      source = Path.expand(to_string(opts[:hex] || app), System.fetch_env!("SITU_HEX_PATH"))

      cond do
        opts[:path] || opts[:in_umbrella] -> nil
        # A package may get its own dependencies from Git.
        opts[:git] && not File.dir?(source) -> nil
        true -> [dest: source] ++ opts
      end
    end

    @impl true
    def fetchable?, do: false
    @impl true
    def format(opts), do: opts[:dest]
    @impl true
    def format_lock(_opts), do: nil
    @impl true
    def checked_out?(opts), do: File.dir?(opts[:dest])
    @impl true
    def checkout(_opts), do: nil
    @impl true
    def update(opts), do: opts[:lock]
    @impl true
    def lock_status(_opts), do: :ok
    @impl true
    def equal?(opts1, opts2), do: opts1[:dest] == opts2[:dest]
    @impl true
    def managers(_opts), do: []
  end

  @root Path.expand("..", __DIR__)

  @doc "Returns the configuration of the project `app`, with the apps of Situ and the packages that it uses."
  def project(app, opts) do
    {packages, opts} = Keyword.pop(opts, :packages, [])

    Keyword.merge(
      [
        app: app,
        version: "1.0.0",
        elixir: "~> 1.14",
        # Mix must not remove the compiled Situ from the code path.
        prune_code_paths: false,
        start_permanent: Mix.env() == :prod,
        deps: situ_deps() ++ packages
      ],
      opts
    )
  end

  @doc "Makes the sources of the packages and Situ known to Mix. Call it before the project is defined."
  def prepare do
    if System.get_env("SITU_HEX_PATH"), do: Mix.SCM.prepend(Folder)
    if situ_deps() == [], do: Code.require_file("config/installed.exs", @root)
    :ok
  end

  # The project that has this one as a dependency is still on top of Mix's stack.
  defp situ_deps do
    # `Mix.install` has a project without a module, so its configuration is read from the stack.
    if List.keymember?(Mix.Project.config()[:deps] || [], :situ, 0),
      do: [{:situ, path: Path.join(@root, "apps/situ")}],
      else: []
  end
end
