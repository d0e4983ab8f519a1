// As context.h; c10d uses no name of this header.
#pragma once
