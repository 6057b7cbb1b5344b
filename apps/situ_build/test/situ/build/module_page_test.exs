defmodule Situ.Build.ModulePageTest do
  # Compiles a module with documentation, and reads it as the API site and the list of signatures do.
  # Not async, because it sets global compiler options.
  use ExUnit.Case, async: false
  alias Situ.Build.{DocLinks, ModuleDocs, ModulePage}

  @source ~S'''
  defmodule Situ.Build.Sample.Shapes do
    @moduledoc """
    Draws shapes, see `area/2` and `Situ.Build.Sample.Shapes`.

    # Example

        iex> 1 + 1
        2
    """
    defstruct [:size]
    @typedoc "A size in metres."
    @type size :: number()
    @opaque t :: %__MODULE__{size: size()}

    @doc "Returns a name. Longer text."
    @callback name(size()) :: String.t()

    @doc """
    Returns the area, a `t:size/0`; [the guide](../../../docs/guide.md) explains it.
    """
    @doc since: "1.1.0"
    @spec area(size(), keyword()) :: size()
    def area(size, _opts \\ []), do: size * size

    @doc "Returns the area."
    @deprecated "Use `area/2`."
    @spec surface(size()) :: size()
    def surface(size), do: area(size)

    @doc false
    def hidden, do: :ok
  end
  '''

  setup_all do
    tmp = Path.join(System.tmp_dir!(), "situ-module-page-#{System.pid()}")
    ebin = Path.join(tmp, "situ_sample/ebin")
    file = Path.join(tmp, "apps/situ_sample/lib/shapes.ex")
    File.mkdir_p!(ebin)
    File.mkdir_p!(Path.dirname(file))
    File.write!(file, @source)
    on_exit(fn -> File.rm_rf!(tmp) end)
    before = Code.compiler_options()
    on_exit(fn -> Code.compiler_options(before) end)
    Code.compiler_options(docs: true, debug_info: true)
    {:ok, _, _} = Kernel.ParallelCompiler.compile_to_path([file], ebin)
    [module] = ModuleDocs.read_all(tmp, ["Situ.Build.Sample.Shapes"])
    pages = %{"docs/guide.md" => "guide.html"}
    links = DocLinks.new([module], pages, "https://example.org/%{path}#L%{line}")
    %{module: module, page: ModulePage.render_page(module, "stable", links)}
  end

  test "reads functions, types, callbacks and fields, but nothing hidden", %{module: module} do
    assert {module.app, module.path, module.fields} ==
             {"situ_sample", "apps/situ_sample/lib/shapes.ex", [:size]}

    names = for entry <- module.entries, do: {entry.kind, entry.name, entry.arities}

    assert Enum.sort(names) == [
             {:callback, :name, 1..1},
             {:function, :area, 1..2},
             {:function, :surface, 1..1},
             {:type, :size, 0..0},
             {:type, :t, 0..0}
           ]

    assert %{since: "1.1.0", code: "@spec area(size(), keyword()) :: size()"} =
             Enum.find(module.entries, &(&1.name == :area))

    assert %{deprecated: "Use `area/2`."} = Enum.find(module.entries, &(&1.name == :surface))
    assert %{code: "@opaque t()"} = Enum.find(module.entries, &(&1.name == :t))
  end

  test "the page has an anchor for each arity, and links names, types, files and sources", %{
    page: page
  } do
    for anchor <- ~w(area/1 area/2 surface/1 t:size/0 t:t/0 c:name/1),
        do: assert(page =~ ~s(id="#{anchor}"))

    assert page =~ "[`area/2`](../api/Situ.Build.Sample.Shapes.html#area/2)"
    assert page =~ "see [`area/2`]"
    assert page =~ "[the guide](../guide.html)"
    assert page =~ ~s(<a href="../api/Situ.Build.Sample.Shapes.html#t:size/0">size\(\)</a>)
    assert page =~ ~r{https://example.org/apps/situ_sample/lib/shapes.ex#L\d+}
    refute page =~ "hidden"
  end

  test "the page shows facts, doctests as code, and headings below its own", %{page: page} do
    assert page =~ "since 1.1.0"
    assert page =~ "> **Deprecated**: Use [`area/2`]"
    assert page =~ "## Example\n\n```iex\niex> 1 + 1\n2\n```"
    assert page =~ ~s(<span class="status stable">)
  end
end
