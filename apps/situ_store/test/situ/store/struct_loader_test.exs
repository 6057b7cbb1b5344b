defmodule Situ.Store.StructLoaderTest do
  # Structs of modules that exist but are not loaded.
  use ExUnit.Case, async: true

  @moduletag :tmp_dir

  defp struct_term(module, field, value) do
    atom = fn text -> <<119, byte_size(text), text::binary>> end

    <<131, 116, 0, 0, 0, 2, atom.("__struct__")::binary, atom.(module)::binary,
      atom.(field)::binary, 97, value>>
  end

  # Lists the modules in an application, as a release or Mix does.
  defp list_modules(modules) do
    app = :"later_app_#{System.unique_integer([:positive])}"
    spec = {:application, app, vsn: '1', modules: modules, applications: [], registered: []}
    :ok = :application.load(spec)
    on_exit(fn -> Application.unload(app) end)
  end

  test "a recording does not determine which code is loaded", %{tmp_dir: root} do
    n = System.unique_integer([:positive])
    source = Path.join(root, "evil.ex")
    mark = Path.join(root, "ran")

    File.write!(source, """
    defmodule Evil#{n} do
      @on_load :run
      defstruct [:evil_#{n}]
      def run, do: File.write(#{inspect(mark)}, "")
    end
    """)

    # Compiling also runs the function, in the compiling system.
    {_, 0} = System.cmd("elixirc", ["-o", root, source])
    File.rm(mark)
    true = Code.prepend_path(root)
    name = "Elixir.Evil#{n}"
    term = struct_term(name, "evil_#{n}", 5)

    # Neither an unknown name nor an existing atom may load a file from the code path.
    for store <- ["unknown", "known"] do
      assert %{"__struct__" => ^name} = Situ.Store.Test.Raw.decode(Path.join(root, store), term)
      _ = Situ.Store.TypeName.parse_type("Evil#{n}")
      _ = Situ.Store.TypeName.parse_type("{:list, Evil#{n}}")

      module =
        if store == "unknown", do: String.to_atom(name), else: String.to_existing_atom(name)

      refute Situ.Type.accepts?(:map, module)
      refute Situ.Codec.implemented_by?(module)
      refute File.exists?(mark)
    end

    Code.delete_path(root)
  end

  test "decodes a struct whose module exists but was not loaded yet", %{tmp_dir: root} do
    n = System.unique_integer([:positive])
    name = "Elixir.LoadedLater#{n}"
    source = Path.join(root, "later.ex")
    File.write!(source, "defmodule LoadedLater#{n} do defstruct [:later_#{n}] end")
    # The module is compiled by another system, so this VM does not know its field.
    {_, 0} = System.cmd("elixirc", ["-o", root, source])
    term = struct_term(name, "later_#{n}", 5)

    assert %{"__struct__" => ^name} = Situ.Store.Test.Raw.decode(Path.join(root, "a"), term)
    assert_raise ArgumentError, fn -> String.to_existing_atom("later_#{n}") end

    # Now an application's module list contains it, as in a release.
    module = String.to_atom(name)
    true = Code.append_path(root)
    list_modules([module])
    assert decoded = Situ.Store.Test.Raw.decode(Path.join(root, "b"), term)
    assert %{__struct__: ^module} = decoded
    assert Map.values(Map.from_struct(decoded)) == [5]
    # Structs within other terms are decoded, too.
    <<131, inner::binary>> = struct_term(name, "later_#{n}", 6)

    assert [%{__struct__: ^module}] =
             Situ.Store.Test.Raw.decode(
               Path.join(root, "c"),
               <<131, 108, 0, 0, 0, 1, inner::binary, 106>>
             )

    Code.delete_path(root)
  end

  test "decodes nested structs of existing modules on the first read", %{tmp_dir: root} do
    n = System.unique_integer([:positive])
    source = Path.join(root, "nested.ex")

    File.write!(source, """
    defmodule Outer#{n} do defstruct [:inner_#{n}] end
    defmodule Inner#{n} do defstruct [:deep_#{n}] end
    """)

    {_, 0} = System.cmd("elixirc", ["-o", root, source])
    inner = struct_term("Elixir.Inner#{n}", "deep_#{n}", 7)
    <<131, body::binary>> = struct_term("Elixir.Outer#{n}", "inner_#{n}", 0)
    # Replaces the small integer 0 at the end with the inner struct.
    outer =
      <<131, binary_part(body, 0, byte_size(body) - 2)::binary,
        binary_part(inner, 1, byte_size(inner) - 1)::binary>>

    true = Code.append_path(root)
    list_modules([:"Elixir.Outer#{n}", :"Elixir.Inner#{n}"])
    assert %module{} = decoded = Situ.Store.Test.Raw.decode(Path.join(root, "n"), outer)
    assert inspect(module) == "Outer#{n}"
    assert [%nested{} = deep] = Map.values(Map.from_struct(decoded))
    assert inspect(nested) == "Inner#{n}" and Map.values(Map.from_struct(deep)) == [7]
    Code.delete_path(root)
  end
end
