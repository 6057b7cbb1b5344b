defmodule Situ.Store.StructsTest do
  # Structs of modules that are there but that nobody has loaded.
  use ExUnit.Case, async: true

  @moduletag :tmp_dir

  defp struct_term(module, field, value) do
    atom = fn text -> <<119, byte_size(text), text::binary>> end

    <<131, 116, 0, 0, 0, 2, atom.("__struct__")::binary, atom.(module)::binary,
      atom.(field)::binary, 97, value>>
  end

  test "a struct whose module is there but was not loaded yet is the struct", %{tmp_dir: root} do
    n = System.unique_integer([:positive])
    name = "Elixir.LoadedLater#{n}"
    source = Path.join(root, "later.ex")
    File.write!(source, "defmodule LoadedLater#{n} do defstruct [:later_#{n}] end")
    # Compiled by another system: here nobody has heard of its field.
    {_, 0} = System.cmd("elixirc", ["-o", root, source])
    term = struct_term(name, "later_#{n}", 5)

    assert %{"__struct__" => ^name} = Situ.Store.Test.Raw.decode(Path.join(root, "a"), term)
    assert_raise ArgumentError, fn -> String.to_existing_atom("later_#{n}") end

    # An application's list of modules names it, as a release's does.
    module = String.to_atom(name)
    true = Code.append_path(root)
    assert decoded = Situ.Store.Test.Raw.decode(Path.join(root, "b"), term)
    assert %{__struct__: ^module} = decoded
    assert Map.values(Map.from_struct(decoded)) == [5]
    # So do structs within other terms.
    <<131, inner::binary>> = struct_term(name, "later_#{n}", 6)

    assert [%{__struct__: ^module}] =
             Situ.Store.Test.Raw.decode(
               Path.join(root, "c"),
               <<131, 108, 0, 0, 0, 1, inner::binary, 106>>
             )

    Code.delete_path(root)
  end

  test "structs within structs of modules that are there are structs from the first read on", %{
    tmp_dir: root
  } do
    n = System.unique_integer([:positive])
    source = Path.join(root, "nested.ex")

    File.write!(source, """
    defmodule Outer#{n} do defstruct [:inner_#{n}] end
    defmodule Inner#{n} do defstruct [:deep_#{n}] end
    """)

    {_, 0} = System.cmd("elixirc", ["-o", root, source])
    inner = struct_term("Elixir.Inner#{n}", "deep_#{n}", 7)
    <<131, body::binary>> = struct_term("Elixir.Outer#{n}", "inner_#{n}", 0)
    # The small integer 0 at the end gives way to the struct.
    outer =
      <<131, binary_part(body, 0, byte_size(body) - 2)::binary,
        binary_part(inner, 1, byte_size(inner) - 1)::binary>>

    true = Code.append_path(root)
    assert %module{} = decoded = Situ.Store.Test.Raw.decode(Path.join(root, "n"), outer)
    assert inspect(module) == "Outer#{n}"
    assert [%nested{} = deep] = Map.values(Map.from_struct(decoded))
    assert inspect(nested) == "Inner#{n}" and Map.values(Map.from_struct(deep)) == [7]
    Code.delete_path(root)
  end
end
