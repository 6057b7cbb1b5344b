defmodule Situ.Build.ArchitectureTest do
  # Not async, because it sets a global compiler option.
  use ExUnit.Case, async: false
  alias Situ.Build.{Architecture, Cycles}
  doctest Architecture
  doctest Situ.Build.Layers
  doctest Situ.Build.Cycles
  doctest Situ.Build.Sources
  doctest Situ.Build.Definitions
  doctest Situ.Build.Names
  doctest Situ.Build.English
  doctest Situ.Build.Limits
  doctest Situ.Build.Decisions
  doctest Situ.Build.Commits
  doctest Situ.Build.PublicModules
  doctest Situ.Build.Signatures
  doctest Situ.Build.DocLinks
  doctest Situ.Build.Markdown
  doctest Situ.Build.SitePages

  defp compile(source, tmp, apps) do
    before = Code.get_compiler_option(:debug_info)
    Code.put_compiler_option(:debug_info, true)
    on_exit(fn -> Code.put_compiler_option(:debug_info, before) end)

    for {module, beam} <- Code.compile_string(source) do
      ebin = Path.join([tmp, to_string(Map.get(apps, module, :situ)), "ebin"])
      File.mkdir_p!(ebin)
      File.write!(Path.join(ebin, "#{module}.beam"), beam)
    end

    Architecture.read_modules(tmp)
  end

  @tag :tmp_dir
  test "finds struct literals and module names passed as values", %{tmp_dir: tmp} do
    modules =
      compile(
        """
        defmodule Situ.Build.Sample.Sibling do
          defstruct [:x]
        end

        defmodule Situ.Build.Sample.ByStruct do
          def f(%Situ.Build.Sample.Sibling{x: x}), do: x
        end

        defmodule Situ.Build.Sample.ByValue do
          def f, do: Situ.Build.Sample.Sibling
        end
        """,
        tmp,
        %{Situ.Build.Sample.Sibling => :situ_store}
      )

    assert [by_struct, by_value] = Architecture.find_violations(modules)
    assert by_struct =~ "ByStruct names Situ.Build.Sample.Sibling"
    assert by_value =~ "ByValue names Situ.Build.Sample.Sibling"
  end

  @tag :tmp_dir
  test "finds cycles of calls and captures, but not of structs", %{tmp_dir: tmp} do
    modules =
      compile(
        """
        defmodule Situ.Build.Sample.A do
          defstruct []
          def f, do: Situ.Build.Sample.B.f()
        end

        defmodule Situ.Build.Sample.B do
          def f, do: Enum.map([1], &Situ.Build.Sample.C.f/1)
        end

        defmodule Situ.Build.Sample.C do
          def f(_), do: Situ.Build.Sample.A.f()
        end

        defmodule Situ.Build.Sample.D do
          def f, do: Situ.Build.Sample.E.f(%Situ.Build.Sample.A{})
        end

        defmodule Situ.Build.Sample.E do
          def f(%Situ.Build.Sample.A{}), do: :ok
        end
        """,
        tmp,
        %{}
      )

    assert [[Situ.Build.Sample.A, Situ.Build.Sample.B, Situ.Build.Sample.C]] =
             Cycles.find_in_modules(modules.situ)
  end

  @tag :tmp_dir
  test "finds cycles between the files of a crate", %{tmp_dir: tmp} do
    File.mkdir_p!(Path.join(tmp, "reader"))
    File.write!(Path.join(tmp, "lib.rs"), "pub mod a;\npub mod reader;\n")
    File.write!(Path.join(tmp, "a.rs"), "use crate::reader::maps::Map;\n")
    File.write!(Path.join(tmp, "reader/maps.rs"), "// crate::reader\nuse crate::a::{X, Y};\n")
    File.write!(Path.join(tmp, "reader/mod.rs"), "#[cfg(test)]\nuse crate::a;\n")

    assert Cycles.find_in_crate(tmp) == [["a", "reader::maps"]]
  end
end
