defmodule Situ.Build.ArchitectureTest do
  # Sets a compiler option, which is global.
  use ExUnit.Case, async: false
  alias Situ.Build.Architecture
  doctest Architecture

  @tag :tmp_dir
  test "sees struct literals and module names passed as values", %{tmp_dir: tmp} do
    ebin = fn app -> Path.join([tmp, app, "ebin"]) end
    for app <- ~w(situ situ_store), do: File.mkdir_p!(ebin.(app))

    before = Code.get_compiler_option(:debug_info)
    Code.put_compiler_option(:debug_info, true)
    on_exit(fn -> Code.put_compiler_option(:debug_info, before) end)

    compiled =
      Code.compile_string("""
      defmodule Situ.Build.Sample.Sibling do
        defstruct [:x]
      end

      defmodule Situ.Build.Sample.ByStruct do
        def f(%Situ.Build.Sample.Sibling{x: x}), do: x
      end

      defmodule Situ.Build.Sample.ByValue do
        def f, do: Situ.Build.Sample.Sibling
      end
      """)

    for {module, beam} <- compiled do
      app = if module == Situ.Build.Sample.Sibling, do: "situ_store", else: "situ"
      File.write!(Path.join(ebin.(app), "#{module}.beam"), beam)
    end

    assert [by_struct, by_value] = tmp |> Architecture.modules() |> Architecture.violations()
    assert by_struct =~ "ByStruct names Situ.Build.Sample.Sibling"
    assert by_value =~ "ByValue names Situ.Build.Sample.Sibling"
  end
end
